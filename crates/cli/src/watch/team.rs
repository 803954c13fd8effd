//! The command `murmurate watch`: serves the live page of a real team, from the messages that an operator receives.
//! `launch --watch` serves the same page.

use std::cell::{Cell, RefCell};
use std::collections::BTreeMap;
use std::io::Read;
use std::path::Path;
use std::rc::Rc;
use std::sync::atomic::Ordering;
use std::sync::mpsc::{Receiver, TryRecvError};
use std::time::Instant;

use anyhow::Result;

use super::PageFlags;
use super::feed::Feed;
use murmurate::actors::network;
use murmurate::actors::order::OrderKind;
use murmurate::deploy::team::TeamFile;
use murmurate::deploy::{Deployment, Routes};
use murmurate::graph::event::Event;
use murmurate::graph::operator;
use murmurate::live::links::ProcessIdentity;
use murmurate::messages::ids::{HostId, RobotId};
use murmurate::messages::wire::{Phase, Stop, Wire};
use murmurate::policy::Models;
use murmurate::registry::Registry;
use murmurate::results::episode::Episode;
use murmurate::runtime::clock::Clock;
use murmurate::runtime::real::run_real;
use murmurate::runtime::shell::Mailbox;
use murmurate::scenario::layout::Layouts;

use murmurate::time::{Span, Time};
use murmurate_record::stage::Stage;
use murmurate_report::heard::Heard;
use murmurate_robot::output::talk;
use murmurate_robot::recording::LiveRecord;
use murmurate_robot::recording::RecordFlags;
use murmurate_robot::{Ended, signals, team};
use murmurate_view::access::Control;
use murmurate_view::command::Command;
use murmurate_view::metrics::Metrics;
use murmurate_view::orders::Orders;
use murmurate_view::scans::ScanForm;
use murmurate_view::server::{Publisher, Server};
use murmurate_view::status::{Ending, Scene};
use murmurate_view::team_view::TeamView;

/// Period at which commands of the page are executed, orders to the team repeated, and the page updated.
const BEAT: Span = Span::from_millis(10);
/// Period at which this operator asks all hosts for the state of the emergency stop latch at their robots.
const ASK: Span = Span::from_millis(1000);

/// Event of a run, from the program that runs the team to its live page.
pub enum TeamEvent {
    /// Result of an episode.
    Episode(Episode),
    /// The process of the host with this index has died; the text names it and says how.
    Died(usize, String),
    /// The process of the host with this index is back; the text names it.
    Back(usize, String),
    /// Report of the host with this index on the hosts that it hears, and on its way of sending.
    Heard(usize, Heard),
    /// The run is over.
    Over(Ending),
}

/// State of this process, in a word, in its last message to the page.
const OVER: &str = "over";

/// Shows a running team on a page in the browser, with its emergency stop.
#[derive(clap::Args)]
#[command(after_help = "Runs on any machine that reaches the link which carries 'stop'. Ctrl-C ends the page and \
    changes nothing for the team.\nExit codes: 0 ended by Ctrl-C; 1 the link or the page cannot be opened; 2 a flag, \
    the team file, the key or the token is wrong.")]
pub struct Args {
    #[command(flatten)]
    team: team::TeamArgs,
    #[command(flatten)]
    page: PageFlags,
    /// Flags for a record of what this command receives from the team.
    #[command(flatten)]
    record: RecordFlags,
}

/// Runs `watch`: serves the live page of a team until the user ends it by Ctrl-C.
pub fn run(args: &Args, registry: &Registry) -> Result<Ended> {
    let (signal, waker) = signals::listen()?;
    let file = args.team.read(registry)?;
    let page = Page::open(&file, &args.team, &args.page, registry, None)?;
    let record = page.record(&args.record, &args.team.file)?;
    page.run(&args.team, registry, record, || {
        // Empties the pipe whose byte has woken this thread.
        let _ = (&*waker).read(&mut [0; 16]);
        signal.load(Ordering::Relaxed) != 0
    })?;
    Ok(Ended::Done)
}

/// Live page of a team that is served, while this process has not joined the team's network yet.
pub struct Page {
    view: TeamView,
    server: Server,
    publisher: Publisher,
    events: Option<Receiver<TeamEvent>>,
    /// Identity (incarnation and seed) of this process as an operator of the team.
    identity: ProcessIdentity,
    /// Time zero of this process's clock.
    began: Instant,
    stage: Stage,
}

impl Page {
    /// Opens the live page of a team, and prints its address. `events` receives the results of episodes, and the deaths
    /// and returns of processes; `None` if this process does not get them.
    pub fn open(
        file: &TeamFile,
        team: &team::TeamArgs,
        flags: &PageFlags,
        registry: &Registry,
        events: Option<Receiver<TeamEvent>>,
    ) -> Result<Page> {
        let deployment = file.deployment();
        let some = team.for_host(file, HostId(0))?;
        let scenario = team::scenario(&some, registry)?;
        // The machine of an operator need not have the policy file. Then the communication range is unknown.
        let policy = team::policy(&some, registry).ok();
        let routes = Routes::of(deployment);
        let range_m = policy.as_ref().map(|policy| farthest_m(deployment, &policy.models));
        let layouts = Layouts::of_scenario(&*scenario, some.seed, some.episodes);
        let scene = Scene {
            scenario: some.scenario.clone(),
            mode: deployment.mode.clone(),
            policy: policy.map_or_else(String::new, |policy| policy.name),
            robots: deployment.robots,
            episodes: some.episodes,
            range_m: range_m.filter(|range_m| range_m.is_finite()),
            scans: scans(deployment, registry),
            hears_links: false,
            hears_results: events.is_some(),
            drawn: layouts.drawn_blocks(),
            movers: layouts.movers(scenario.arena()),
            waypoints: layouts.waypoints(),
            unlabelled: scenario.goals().are_unlabelled(),
            ..Scene::of_arena(scenario.arena())
        };
        let homes = RobotId::team(deployment.robots).map(|robot| routes.agent_host(robot)).collect();
        let (server, publisher) = flags.open(scene.clone(), Control::Team)?;
        Ok(Page {
            view: {
                let names = deployment.hosts.iter().map(|host| host.name.clone()).collect();
                TeamView::new(scene, homes, deployment.hosts.len()).on_mesh(names, routes.server_host())
            },
            server,
            publisher,
            events,
            identity: ProcessIdentity::draw()?,
            began: Instant::now(),
            stage: {
                let range_m = range_m.unwrap_or(f32::INFINITY);
                let stage = Stage::of_team((deployment, &*scenario), scenario.arena().robot_radius_m, range_m);
                stage.with_layouts(&layouts, scenario.arena())
            },
        })
    }

    /// Creates the record of what this process receives as an operator; `None` if the flags name no folder.
    fn record(&self, flags: &RecordFlags, team: &Path) -> Result<Option<LiveRecord>> {
        let run = (self.identity.incarnation, self.stage.clone());
        LiveRecord::of_operator(flags, run, self.began, vec![team.to_owned()])
    }

    /// Joins the team's network as an operator, and updates the page on this thread until `over` returns `true`, or
    /// until an event says that the run is over. The page receives a last status. The messages that the operator
    /// receives are also written to `record`, if given.
    pub fn run(
        self,
        team: &team::TeamArgs,
        registry: &Registry,
        record: Option<LiveRecord>,
        over: impl Fn() -> bool,
    ) -> Result<()> {
        let Page { view, server, publisher, events, identity, began, .. } = self;
        let file = team.read(registry)?;
        let operator = team.operator_as(&file, identity)?;
        let me = operator.end.me;
        let names = file.deployment().hosts.iter().map(|host| host.name.clone()).collect();
        let metrics = Rc::new(RefCell::new(Metrics::new(names)));
        let view = Rc::new(RefCell::new(view));
        let orders = Rc::new(RefCell::new(Orders::new(me.host, operator.robots)));
        let (feed, ask_at) = (Feed::new(Rc::clone(&view), Some(Rc::clone(&metrics))), Time::ZERO);
        let record = record.map(Rc::new);
        let (taken, turned) = (record.clone(), record.clone());
        let (trouble, end) = (Rc::new(Cell::new(None)), Rc::new(End::default()));
        let ended = Rc::clone(&end);
        run_real(
            began,
            |clock, readers| {
                let (seen, given, time) = (Rc::clone(&view), Rc::clone(&orders), clock.clone());
                let counted = Rc::clone(&trouble);
                let network = operator::wire((clock, readers), operator, move |event| {
                    metrics.borrow_mut().take(me.host, event);
                    taken.iter().for_each(|record| record.push(me.host, event));
                    if let Event::Counts(counts) = event {
                        counted.set(counts.key_trouble());
                    }
                    let Event::Message(message) = event else {
                        return seen.borrow_mut().take_event(time.now(), me.host, event);
                    };
                    if let Wire::Status(status) = message {
                        given.borrow_mut().receive(time.now(), status);
                    }
                    seen.borrow_mut().receive(time.now(), message);
                });
                operator::observe(clock, &network, me.host);
                let (pause_after, ending) = (None, None);
                let (known, trouble) = (None, trouble);
                let desk = Desk {
                    me: me.host,
                    network,
                    view,
                    orders,
                    publisher,
                    events,
                    feed,
                    pause_after,
                    ask_at,
                    trouble,
                    known,
                    ending,
                    end,
                };
                desk.beat(clock);
            },
            |(), now| {
                turned.iter().for_each(|record| record.turn(now, None));
                ended.asked.set(ended.asked.get() || over());
                ended.published.get()
            },
        );
        server.close();
        record.map_or(Ok(()), |record| record.finish())
    }
}

/// State of the end of the page, which the event loop and the desk share.
#[derive(Default)]
struct End {
    /// Whether the user has ended this command.
    asked: Cell<bool>,
    /// Whether the last status has been published.
    published: Cell<bool>,
}

/// Does the periodic work of the page: executes commands, repeats orders, and publishes the team's state.
struct Desk {
    me: HostId,
    network: Mailbox<network::In>,
    view: Rc<RefCell<TeamView>>,
    orders: Rc<RefCell<Orders>>,
    publisher: Publisher,
    events: Option<Receiver<TeamEvent>>,
    feed: Feed,
    /// Episode after which the team is to be held, because a page has asked for a pause; `None` without such a request.
    pause_after: Option<u32>,
    /// Time at which hosts are asked next for the state of the emergency stop latch at their robots.
    ask_at: Time,
    /// Reason why this operator understands nothing of the team; `None` if there is none.
    trouble: Rc<Cell<Option<&'static str>>>,
    /// The last such reason that was logged.
    known: Option<&'static str>,
    /// End of the run, or of this page.
    ending: Option<Ending>,
    end: Rc<End>,
}

impl Desk {
    fn beat(mut self, clock: &Clock) {
        let now = clock.now();
        while let Some(command) = self.publisher.command() {
            self.execute(now, command);
        }
        self.take_events(now);
        self.log_trouble(now);
        self.take_pause(now);
        let mut message = self.orders.borrow_mut().turn(now);
        if let Some(result) = self.orders.borrow_mut().take_result() {
            self.view.borrow_mut().note(now, &result);
        }
        if message.is_none() && now >= self.ask_at {
            (message, self.ask_at) = (Some(Stop::ask(self.me)), now + ASK);
        }
        message.into_iter().for_each(|stop| self.network.send(network::In::Publish(Wire::Stop(stop))));
        let ordering = self.orders.borrow().is_running();
        let pause = if self.pause_after.is_some() { "asked" } else { "no" };
        let own = match &self.ending {
            Some(_) => OVER,
            None if ordering => "ordering",
            None => pause,
        };
        let (ending, trouble) = (self.ending.clone(), self.trouble.get());
        self.feed.publish(&self.publisher, now, own, |status| {
            (status.ordering, status.pause, status.trouble) = (ordering, pause, trouble);
            (status.over, status.ending) = (ending.is_some(), ending);
        });
        self.end.published.set(self.feed.has_published(OVER));
        let again = clock.clone();
        clock.call(now + BEAT, Box::new(move || self.beat(&again)));
    }

    /// Handles the events of the program that runs the team, and the request to end the page.
    fn take_events(&mut self, now: Time) {
        loop {
            match self.events.as_ref().map(Receiver::try_recv) {
                Some(Ok(TeamEvent::Episode(episode))) => self.view.borrow_mut().judged(now, &episode),
                Some(Ok(TeamEvent::Died(host, text))) => {
                    self.view.borrow_mut().process(now, (id(host), true), &text);
                    self.feed.status_at_once();
                }
                Some(Ok(TeamEvent::Back(host, text))) => {
                    self.view.borrow_mut().process(now, (id(host), false), &text);
                    self.feed.status_at_once();
                }
                Some(Ok(TeamEvent::Heard(host, heard))) => self.view.borrow_mut().heard(now, id(host), heard),
                Some(Ok(TeamEvent::Over(ending))) => self.ending = Some(ending),
                Some(Err(TryRecvError::Disconnected)) if self.ending.is_none() => {
                    let text = "The program that ran the team has ended.".to_owned();
                    self.ending = Some(Ending { regular: false, text });
                }
                Some(Err(_)) | None => break,
            }
        }
        if self.end.asked.get() && self.ending.is_none() {
            let text =
                "This page has ended, and the team goes on without it: STOP has no effect here any more.".to_owned();
            self.ending = Some(Ending { regular: true, text });
        }
    }

    /// Logs once, on the terminal and on the page, why nothing of the team is understood.
    fn log_trouble(&mut self, now: Time) {
        let trouble = self.trouble.get();
        if let Some(trouble) = trouble.filter(|_| trouble != self.known) {
            talk(&format!("warning: {trouble}"));
            self.view.borrow_mut().note(now, trouble);
        }
        self.known = trouble.or(self.known);
    }

    /// Orders the team to hold once the episode `pause_after` is over, if a pause was requested. The next episode
    /// begins after a resume.
    fn take_pause(&mut self, now: Time) {
        let (Some(after), Some((phase, episode))) = (self.pause_after, self.view.borrow().phase()) else { return };
        match phase {
            Phase::Running | Phase::FinishedRunning | Phase::AbortRunning if episode == after => {}
            // The state server's instruction between the episodes was not received. The new episode is not aborted; the
            // pause follows it.
            Phase::Running | Phase::FinishedRunning => self.pause_after = Some(episode),
            _ => {
                self.pause_after = None;
                let latch = self.view.borrow().latch();
                self.orders.borrow_mut().hold(now, latch);
            }
        }
    }

    fn execute(&mut self, now: Time, command: Command) {
        let kind = match command {
            Command::Stop => OrderKind::Stop,
            Command::Rearm => OrderKind::Rearm,
            Command::Resume if self.pause_after.take().is_some() => {
                return self.view.borrow_mut().note(now, "page: goes on");
            }
            Command::Resume => OrderKind::Resume,
            Command::Pause => {
                let Some((_, episode)) = self.view.borrow().phase() else {
                    return self.view.borrow_mut().note(now, "page: refused, the state server was not heard yet");
                };
                self.pause_after = Some(episode);
                return self.view.borrow_mut().note(now, "page: pause after this episode");
            }
            Command::Kill { .. } | Command::Restart { .. } | Command::Link { .. } => {
                return self.view.borrow_mut().note(now, "page: refused, that is for simulations");
            }
            // Not reached: these commands are refused before, because no record is played.
            Command::Play { .. } | Command::Seek { .. } | Command::Step { .. } => return,
        };
        if kind == OrderKind::Stop {
            self.pause_after = None;
            self.view.borrow_mut().note(now, "page: STOP");
        }
        if let Err(why) = self.orders.borrow_mut().give(now, kind) {
            self.view.borrow_mut().note(now, &format!("page: refused, {why}"));
        }
    }
}

/// Returns the id of the host with this index in the deployment.
fn id(host: usize) -> HostId {
    HostId(u16::try_from(host).expect("hosts are counted in u16"))
}

/// Returns the largest distance within which a robot of the team hears others \[m\].
fn farthest_m(deployment: &Deployment, models: &Models) -> f32 {
    RobotId::team(deployment.robots).map(|robot| deployment.radius_m(robot, models)).fold(0.0, f32::max)
}

/// Returns the directions of the rays of each sense of a checked team whose values are distances along rays.
fn scans(deployment: &Deployment, registry: &Registry) -> Vec<ScanForm> {
    let mut forms = BTreeMap::new();
    for robot in RobotId::team(deployment.robots) {
        for (index, name, settings) in deployment.senses_of(robot) {
            let layout = registry.sense(name, settings, robot).ok().map(|parts| parts.layout);
            forms.entry(index).or_insert(layout);
        }
    }
    forms.into_iter().filter_map(|(index, layout)| ScanForm::of(usize::from(index), &layout?)).collect()
}
