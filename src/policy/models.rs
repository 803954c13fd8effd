//! Models of a team: one for all robots, or one for each role.
//!
//! Robots of unequal models understand each other only if their messages have one contract, which is compared here.

use std::sync::Arc;

use super::{Interface, Model};
use crate::messages::ids::RobotId;
use crate::messages::wire::{Form, Missing};
use crate::time::Span;

/// Largest difference between the period of a model and a multiple of the team's, from rounding of rates to periods.
const ROUNDING: Span = Span::from_nanos(1000);

/// Models of a team, by robot. Their messages have one contract, and their periods are multiples of the shortest one.
#[derive(Clone, Debug)]
pub struct Models {
    /// Models with the names of their roles; the first is for all robots that `of` does not list.
    roles: Vec<(String, Model)>,
    /// Index of the model of each robot; empty if all have the first one.
    of: Arc<[usize]>,
}

/// Error of roles whose models do not fit together.
#[derive(Clone, Debug, PartialEq, thiserror::Error)]
#[error("{why}")]
pub struct Unequal {
    /// Name of the role whose model does not fit those of the roles before it; empty for the robots without a role.
    pub role: String,
    /// Reason, in words.
    pub why: String,
}

impl From<Model> for Models {
    fn from(model: Model) -> Models {
        Models { roles: vec![(String::new(), model)], of: Arc::new([]) }
    }
}

impl Models {
    /// Makes the models of a team from those of its roles, each with its name and its model, and from the index of the
    /// role of each robot. The name is empty for the robots without a role.
    ///
    /// # Errors
    /// If messages of the models have not one contract, or a period is no multiple of the shortest one; the first role
    /// that is wrong is named.
    ///
    /// # Panics
    /// If there is no role, or a robot has an index beyond the roles.
    pub fn of_roles(roles: Vec<(String, Model)>, of: Vec<usize>) -> Result<Models, Unequal> {
        assert!(of.iter().all(|role| *role < roles.len()), "each robot has a role");
        let (first, others) = roles.split_first().expect("a team has a role");
        for (role, model) in others {
            let unequal = |why: String| Unequal { role: role.clone(), why };
            understands(&first.1, model, &first.0).map_err(unequal)?;
        }
        let models = Models { of: of.into(), roles };
        let period = models.period();
        for (role, model) in &models.roles {
            let own = model.interface().period;
            let nearest = Span::from_nanos(times(own, period) * period.as_nanos());
            if own.max(nearest).as_nanos() - own.min(nearest).as_nanos() > ROUNDING.as_nanos() {
                let [own, period] = [own, period].map(|period| 1.0 / period.as_secs());
                let why = format!(
                    "it makes {own:.1} steps a second, which {period:.1}, those of the fastest role, are \
                                   no multiple of"
                );
                return Err(Unequal { role: role.clone(), why });
            }
        }
        Ok(models)
    }

    /// Returns the model of a robot.
    pub fn of(&self, robot: RobotId) -> &Model {
        &self.roles[self.of.get(robot.index()).copied().unwrap_or(0)].1
    }

    /// Returns the name of the role of a robot; empty in a team without roles.
    pub fn role(&self, robot: RobotId) -> &str {
        &self.roles[self.of.get(robot.index()).copied().unwrap_or(0)].0
    }

    /// Returns all models, in the order of the roles.
    pub fn all(&self) -> impl Iterator<Item = &Model> {
        self.roles.iter().map(|(_, model)| model)
    }

    /// Returns the models that `change` makes of these, which must not change their messages and periods.
    pub fn map(self, change: impl Fn(Model) -> Model) -> Models {
        let roles = self.roles.into_iter().map(|(role, model)| (role, change(model))).collect();
        Models { roles, ..self }
    }

    /// Returns the shortest period of a model.
    pub fn period(&self) -> Span {
        self.all().map(|model| model.interface().period).min().expect("a team has a role")
    }

    /// Returns the period of the control ticks of an Agent of `robots`: the shortest one of their models.
    pub fn tick(&self, robots: &[RobotId]) -> Span {
        let periods = robots.iter().map(|robot| self.of(*robot).interface().period);
        periods.min().unwrap_or_else(|| self.period())
    }

    /// Returns how many control ticks of an Agent, whose period is `tick`, the period of the robot's model is long.
    pub fn every(&self, robot: RobotId, tick: Span) -> u32 {
        let every = times(self.of(robot).interface().period, tick);
        u32::try_from(every).expect("periods are 1 to 100 ms")
    }

    /// Returns the number of floats of a message, which is that of all models.
    pub fn features(&self) -> usize {
        self.roles[0].1.interface().features
    }

    /// Returns the form of the messages, which is that of all models.
    pub fn form(&self) -> Form {
        self.roles[0].1.form()
    }

    /// Returns the longest age up to which any policy uses a message.
    pub fn hold(&self) -> Span {
        self.all().map(|model| model.interface().hold).max().expect("a team has a role")
    }

    /// Returns the largest speed along each axis that any model commands \[m/s\].
    pub fn limit_m_s(&self) -> f32 {
        self.all().fold(0.0, |most, model| most.max(model.interface().limit_m_s))
    }

    /// Returns whether a model is computed on a thread of its own on real hosts; then the models of all robots are.
    pub fn run_apart(&self) -> bool {
        self.all().any(Model::runs_apart)
    }

    /// Returns a digest of the policies' files (16 hexadecimal digits), which depends on the robots' roles; that of the
    /// only model in a team without roles, which is empty without a file.
    pub fn digest(&self) -> String {
        let [(_, model)] = &self.roles[..] else {
            let mut hasher = blake3::Hasher::new();
            for index in self.of.iter() {
                let model = &self.roles[*index].1;
                // A name is no digest, and both are of a known form, so no two lists are the same text.
                hasher.update(format!("{} {};", model.name(), model.digest()).as_bytes());
            }
            return hasher.finalize().to_hex()[..16].to_owned();
        };
        model.digest().to_owned()
    }

    /// Returns a number by which hosts with unequal models of the team are told apart; never 0.
    pub fn mark(&self) -> u32 {
        match &self.roles[..] {
            [(_, model)] => model.mark(),
            _ => u32::from_str_radix(&self.digest()[..8], 16).expect("a digest is hexadecimal").max(1),
        }
    }

    /// Returns the names and versions of the engines that compute the models, each once; empty if all models compute
    /// the same bits on every machine.
    pub fn engine(&self) -> String {
        let mut engines: Vec<&str> = Vec::new();
        for engine in self.all().map(Model::engine).filter(|engine| !engine.is_empty()) {
            if !engines.contains(&engine) {
                engines.push(engine);
            }
        }
        engines.join("; ")
    }
}

/// Returns how many times `unit` goes into `span`, rounded.
fn times(span: Span, unit: Span) -> u64 {
    ((span.as_nanos() + unit.as_nanos() / 2) / unit.as_nanos()).max(1)
}

/// Checks that robots with the models `one` and `other` understand each other: their messages have one contract. The
/// error speaks of `other`, and names `role`, that of `one`, or is
/// about the robots without a role if it is empty.
fn understands(one: &Model, other: &Model, role: &str) -> Result<(), String> {
    let (Interface { features: ours, .. }, Interface { features: theirs, .. }) = (one.interface(), other.interface());
    let whose = match role {
        "" => "that of the robots without a role".to_owned(),
        role => format!("that of role '{role}'"),
    };
    let differ = |what: &str, theirs: &dyn std::fmt::Display, ours: &dyn std::fmt::Display| {
        Err(format!("its message has {what} {theirs}, and {whose} {ours}; a team has one kind of message"))
    };
    if theirs != ours {
        return differ("the number of floats", &theirs, &ours);
    }
    let (Form { encoding: sent, missing: kept }, Form { encoding, missing }) = (other.form(), one.form());
    if sent != encoding {
        return differ("the encoding", &sent, &encoding);
    }
    let word = |missing: Missing| serde_json::to_string(&missing).expect("a word").replace('"', "'");
    if kept != missing {
        return differ("for missing parts", &word(kept), &word(missing));
    }
    if ours == 0 || one.is_same_as(other) {
        return Ok(());
    }
    match [other, one].map(Model::message) {
        ["", _] | [_, ""] => Err(format!(
            "it is another policy than {whose}, and that both mean the same by their messages is not \
             said: give both contracts one message.name (policies of formats 1 and 2 have one if their roles were \
             trained together: take such files, or one file)"
        )),
        [theirs, ours] if theirs != ours => differ("the name", &format!("'{theirs}'"), &format!("'{ours}'")),
        _ => Ok(()),
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::messages::wire::{Encoding, Missing};
    use crate::policy::{Interface, Origin, Policy};

    fn model(change: impl Fn(&mut Interface, &mut Origin)) -> Model {
        let (period, hold) = (Span::from_millis(50), Span::from_millis(200));
        let mut interface = Interface { features: 600, radius_m: 2.0, period, limit_m_s: 1.0, hold };
        let mut origin = Origin { digest: "a".repeat(16), message: "pair".to_owned(), ..Origin::default() };
        change(&mut interface, &mut origin);
        let never = |_: &_, _, _| -> Box<dyn Policy> { unreachable!("no test makes an instance") };
        Model::of_file(("custom", interface), origin, None, never).expect("a sound interface")
    }

    fn of(other: Model) -> Result<Models, Unequal> {
        Models::of_roles(vec![("scout".to_owned(), model(|_, _| ())), ("carrier".to_owned(), other)], vec![0, 1, 0])
    }

    #[test]
    fn roles_whose_messages_differ_are_refused_by_name() {
        let refused = |change: fn(&mut Interface, &mut Origin), why: &str| {
            let Err(Unequal { role, why: found }) = of(model(change)) else { panic!("{why}: it is let through") };
            assert_eq!(role, "carrier");
            assert!(found.contains(why) && found.contains("scout"), "{found}");
        };
        refused(|interface, _| interface.features = 8, "the number of floats 8, and");
        refused(|_, origin| origin.form.encoding = Encoding::F16, "the encoding f16");
        refused(|_, origin| origin.form.missing = Missing::Last, "for missing parts 'last'");
        let other = |origin: &mut Origin, message: &str| {
            (origin.digest, origin.message) = ("b".repeat(16), message.to_owned());
        };
        refused(|_, origin| (origin.digest, origin.message) = ("b".repeat(16), "trio".to_owned()), "the name 'trio'");
        refused(|_, origin| (origin.digest, origin.message) = ("b".repeat(16), String::new()), "message.name");
        assert!(of(model(|_, origin| other(origin, "pair"))).is_ok());
        assert!(of(model(|_, _| ())).is_ok(), "robots of one file need no name");
        let Err(Unequal { why, .. }) = of(Model::Orca) else { panic!("it has other messages") };
        assert!(why.contains("floats"), "{why}");
    }

    #[test]
    fn periods_are_multiples_of_the_shortest_one() {
        let slow = |ms: u64| of(model(|interface, _| interface.period = Span::from_millis(ms)));
        let models = slow(100).expect("twice the period");
        let every = |models: &Models, robot: u16, of: &[u16]| {
            models.every(RobotId(robot), models.tick(&of.iter().copied().map(RobotId).collect::<Vec<_>>()))
        };
        assert_eq!([every(&models, 0, &[0, 1, 2]), every(&models, 1, &[0, 1, 2])], [1, 2], "one Agent of all");
        assert_eq!(every(&models, 1, &[1]), 1, "a slower robot alone ticks at its own rate");
        assert_eq!(every(&models, 9, &[9]), 1, "robots beyond the list have the first role");
        let third = of(model(|interface, _| interface.period = Span::from_secs(1.0 / 60.0)));
        assert_eq!(third.map(|models| every(&models, 0, &[0, 1])), Ok(3), "a period of 16.6 ms is rounded");
        let Err(Unequal { role, why }) = slow(70) else { panic!("it is no multiple") };
        assert!(role == "carrier" && why.contains("14.3 steps a second"), "{why}");
    }

    #[test]
    fn the_digest_is_of_all_robots_roles() {
        let two = |of: Vec<usize>| {
            let other = model(|_, origin| origin.digest = "b".repeat(16));
            let roles = vec![("x".to_owned(), model(|_, _| ())), ("y".to_owned(), other)];
            Models::of_roles(roles, of).expect("one kind of message")
        };
        let digest = two(vec![0, 1, 0]).digest();
        assert_eq!((digest.len(), digest == two(vec![0, 1, 0]).digest()), (16, true));
        assert_ne!(digest, two(vec![0, 1, 1]).digest());
        assert_ne!(two(vec![0, 1, 0]).mark(), two(vec![1, 0, 0]).mark());
        let alone = Models::from(model(|_, _| ()));
        assert_eq!((alone.digest(), alone.mark()), ("a".repeat(16), 0xaaaa_aaaa));
        assert_eq!((two(vec![0, 1]).role(RobotId(1)), alone.role(RobotId(1))), ("y", ""));
    }
}
