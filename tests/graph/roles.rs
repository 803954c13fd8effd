//! Teams of two roles, with policies, rates, radii and senses of their own, in every mode.

use std::collections::BTreeMap;
use std::path::Path;
use std::sync::{Arc, Mutex};

use murmurate::deploy::team::TeamFile;
use murmurate::deploy::{Deployment, MODES, Roles, roles_of};
use murmurate::hearing::Handling;
use murmurate::messages::geometry::Vec2;
use murmurate::messages::ids::RobotId;
use murmurate::observation::{Frame, IfStale, Observation, Request, Taking, Unit};
use murmurate::policy::{Interface, Model, Models, Neighbour, Origin, Policy};
use murmurate::random::Stream;
use murmurate::registry::Registry;
use murmurate::time::Span;
use murmurate::trial::Trial;

const ROLES: &str = r#"
[roles.scout]
robots = [0, 2]
radius_m = 4.0
[roles.scout.senses.eyes]
kind = "lidar"
rays = 16
range_m = 3.0

[roles.carrier]
robots = [1]
body = { drive = "differential", point_ahead_m = 0.1 }
"#;

/// Steps of the policies of one role, and the messages that they heard, by their number.
type Seen = Arc<Mutex<(u32, BTreeMap<u32, u32>)>>;

/// Policy that broadcasts the number of its role and drives ahead, if it has the values that it takes.
struct Talking {
    role: f32,
    interface: Interface,
    seen: Seen,
}

impl Policy for Talking {
    fn interface(&self) -> Interface {
        self.interface
    }
    fn encode(&mut self, own: &Observation, features: &mut [f32]) {
        assert_eq!(own.values.len(), if self.role == 1.0 { 16 } else { 0 }, "each role has its own channels");
        features.fill(self.role);
        self.seen.lock().expect("no test has failed").0 += 1;
    }
    fn act(&mut self, _: &Observation, _: &[f32], neighbours: &[Neighbour], _: &mut Stream) -> Vec2 {
        let mut seen = self.seen.lock().expect("no test has failed");
        for neighbour in neighbours {
            *seen.1.entry(neighbour.features[0] as u32).or_default() += 1;
        }
        Vec2::new(0.0, 0.1)
    }
}

fn model(role: f32, (period_ms, radius_m): (u64, f32)) -> (Model, Seen) {
    let (period, hold) = (Span::from_millis(period_ms), Span::from_millis(250));
    let interface = Interface { features: 3, radius_m, period, limit_m_s: 1.0, hold };
    let taking = Taking { stale_after_s: Some(0.3), if_stale: Some(IfStale::Stop), ..Taking::default() };
    let (input, shape, frame) = ("lidar".to_owned(), vec![16], Some(Frame::World));
    let request = Request { input, channel: "eyes".to_owned(), shape, unit: Unit::Metre, frame, taking };
    let requests = if role == 1.0 { vec![request] } else { Vec::new() };
    let digest = format!("{role:016}");
    let origin = Origin { digest, requests, message: "roles".to_owned(), ..Origin::default() };
    let seen = Seen::default();
    let kept = Arc::clone(&seen);
    let instance = move |_: &_, _, _| Box::new(Talking { role, interface, seen: Arc::clone(&kept) }) as Box<dyn Policy>;
    (Model::of_file(("talking", interface), origin, None, instance).expect("a sound interface"), seen)
}

fn roles() -> Roles {
    roles_of(&Registry::builtin(), ROLES, Path::new("")).expect("they are tables of roles")
}

/// Returns the trial of a team of two roles, and what the policies of each have seen.
fn trial(mode: &str) -> (Trial, [Seen; 2]) {
    let (scout, of_scouts) = model(1.0, (50, 0.5));
    let (carrier, of_carriers) = model(2.0, (100, 4.0));
    let two = vec![("scout".to_owned(), scout), ("carrier".to_owned(), carrier)];
    let models = Models::of_roles(two, vec![0, 1, 0]).expect("they have one kind of message");
    let mut trial = Trial::of_team(mode, "passage", 3).expect("a preset").seed(5).models(models);
    trial = trial.lasting(Span::from_millis(12_000));
    trial.deployment = trial.deployment.in_roles(&trial.registry, roles()).expect("sound roles");
    (trial, [of_scouts, of_carriers])
}

#[test]
fn two_roles_run_in_every_mode_each_at_its_rate_and_hear_each_other() {
    for mode in MODES {
        let (first, [scouts, carriers]) = trial(mode);
        assert_eq!(first.check(), Ok(()), "{mode}");
        let report = first.run();
        assert_eq!(report.refused, 0, "{mode}: no mailbox overflows");
        let (scouts, carriers) =
            (scouts.lock().expect("no failure").clone(), carriers.lock().expect("no failure").clone());
        let ratio = f64::from(scouts.0) / f64::from(carriers.0);
        assert!(carriers.0 > 30 && (3.8..4.2).contains(&ratio), "{mode}: two scouts at twice the rate, {ratio}");
        assert!(scouts.1.contains_key(&1) && scouts.1.contains_key(&2), "{mode}: by the role's radius, {:?}", scouts.1);
        assert!(carriers.1.contains_key(&1) && !carriers.1.contains_key(&2), "{mode}: {:?}", carriers.1);
        assert_eq!(trial(mode).0.run().totals.trace, report.totals.trace, "{mode}: the same twice");
    }
}

#[test]
fn messages_that_are_used_once_need_one_rate_within_an_agent() {
    for (mode, refused) in [("sim", true), ("onboard-infra", false)] {
        let (mut trial, _) = trial(mode);
        trial.handling = Handling::AsPublished;
        match trial.check() {
            Ok(()) => assert!(!refused, "{mode}"),
            Err(error) => assert!(refused && error.to_string().starts_with("handling: "), "{mode}: {error}"),
        }
    }
}

#[test]
fn wrong_roles_are_refused_and_name_the_field() {
    let registry = Registry::builtin();
    let preset = || Deployment::preset("onboard-infra", 3).expect("a preset");
    let refused = |from: &str, to: &str, start: &str| {
        assert!(ROLES.contains(from), "{from}");
        let text = ROLES.replacen(from, to, 1);
        let error = roles_of(&registry, &text, Path::new("")).and_then(|roles| preset().in_roles(&registry, roles));
        let error = error.expect_err(to).to_string();
        assert!(error.contains(start), "{to}: {error}");
    };
    refused("robots = [1]", "robots = [1, 2]", "roles.scout.robots: robot 2 has the role 'carrier' already");
    refused("robots = [1]", "robots = [3]", "roles.carrier.robots: there is no robot 3; they are 0 to 2");
    refused("robots = [1]", "robots = []", "roles.carrier.robots: no robot has the role");
    refused("radius_m = 4.0", "radius_m = 0.0", "roles.scout.radius_m");
    refused("[roles.carrier]", "[roles.\"a b\"]", "roles.a b: a name is");
    refused("robots = [1]", "robots = [1]\ncolour = \"red\"", "colour");
    refused("point_ahead_m = 0.1", "point_ahead_m = -0.1", "roles.carrier.body.");
    refused("rays = 16", "rays = 0", "roles.scout.senses.eyes.rays");
    let twice = preset().in_roles(&registry, roles()).and_then(|deployment| deployment.in_roles(&registry, roles()));
    assert!(twice.expect_err("there are some already").to_string().starts_with("roles: the deployment has roles"));
}

#[test]
fn a_policy_whose_sense_only_another_role_has_is_refused_with_its_role() {
    let (mut trial, _) = trial("onboard-infra");
    let scout = trial.deployment.roles.get_mut("scout").expect("there is one");
    (scout.policy, scout.senses) = (Some("scout.toml".into()), Default::default());
    let error = trial.check().expect_err("it has no eyes").to_string();
    assert!(error.starts_with("roles.scout.policy: ") && error.contains("'eyes'"), "{error}");
}

#[test]
fn a_team_file_has_roles_and_its_paths_start_from_its_folder() {
    let text = format!(
        "team = 3\nmode = \"onboard-infra\"\nrobots = 3\n[link.infra]\ninterface = \"lo\"\n\
                        [link.wires]\ninterface = \"lo\"\n{ROLES}\npolicy = \"policies/carrier.policy.toml\"\n"
    );
    let read = |text: &str| TeamFile::read(&Registry::builtin(), text, Path::new("teams"), &[], &[]);
    let file = read(&text).expect("it is sound");
    let (name, carrier) = file.deployment().role_of(RobotId(1)).expect("it has a role");
    let path = Path::new("teams/policies/carrier.policy.toml");
    assert_eq!((name, carrier.policy.as_deref()), ("carrier", Some(path)));
    assert_eq!(file.deployment().chassis(RobotId(1)).point_ahead_m, 0.1);
    assert_eq!(file.deployment().chassis(RobotId(0)).point_ahead_m, 0.0);
    let eyes = |robot| file.deployment().senses_of(RobotId(robot)).len();
    assert_eq!((eyes(0), eyes(1)), (1, 0));
    let error = read(&text.replace("robots = [1]", "robots = [7]")).expect_err("there is no such robot").to_string();
    assert!(error.starts_with("roles.carrier.robots: there is no robot 7"), "{error}");
}
