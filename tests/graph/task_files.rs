//! Task files: the shipped example, the contract of scenarios for every kind of places, and files with mistakes.

use std::path::Path;

use murmurate::config::shown::Layout;
use murmurate::config::shown::printable;
use murmurate::deploy::Deployment;
use murmurate::deploy::senses_of;
use murmurate::deploy::team::TeamFile;
use murmurate::messages::geometry::Planar;
use murmurate::messages::wire::Kind;
use murmurate::policy::Model;
use murmurate::registry::Registry;
use murmurate::scenario::{Settings, TaskFile, contract};
use murmurate::trial::Trial;
use toml::{Table, Value};

const FOUR_ROOMS: &str = include_str!("../../examples/tasks/four-rooms.toml");
const NAVIGATION: &str = include_str!("../../examples/tasks/navigation.toml");
/// The other tasks of the library.
const LIBRARY: [&str; 7] = [
    include_str!("../../examples/tasks/crossing.toml"),
    include_str!("../../examples/tasks/errands.toml"),
    NAVIGATION,
    include_str!("../../examples/tasks/unlabelled.toml"),
    include_str!("../../examples/tasks/unlabelled-table.toml"),
    include_str!("../../examples/tasks/warehouse.toml"),
    include_str!("../../examples/tasks/warehouse-table.toml"),
];
/// A file with each field that the four rooms do not have.
const SHAPES: &str = "name = \"shapes\"\nrobots = { default = 3, least = 2, most = 4 }\nhull_m = 0.1\n\
    ground = { polygon = [[-3, -2], [3, -2], [3, 1], [1, 1], [1, 2.5], [-3, 2.5]] }\n\
    walls = [{ disc = [2, -1, 0.3] }, { polygon = [[-1, 0], [0, -0.3], [0.2, 0.4]] }]\ngoals = \"unlabelled\"\n\
    start = { rect = [-2.8, -1.8, 1, -1] }\ngoal = { polygon = [[-2.8, 1], [0.8, 1], [0.8, 2.3], [-2.8, 2.3]] }\n\
    rules = { arrival_m = 0.2, limit_s = 60.0 }\n\
    obstacles = [{ count = 2, radius_m = 0.1, within = [-3, -2, 3, 2], each_episode = true },\n\
    { count = 2, polygon = [[0, 0], [0.2, 0], [0.1, 0.2]], within = [-3, -1, 3, 2] }]\n\
    movers = [{ radius_m = 0.1, path = [[-1, 0.6], [-0.5, 0.6]], speed_m_s = 0.2, phase = 0.5, closed = true },\n\
    { polygon = [[0, 0], [0.2, 0], [0.1, 0.2]], path = [[1.2, 0.4], [2.2, 0.4]], speed_m_s = 0.3, \
    each_episode = true }]\n\
    senses.eyes = { kind = \"lidar\", rays = 8, range_m = 1.5 }\n";

/// A task file with these lines for its walls and places.
fn file(lines: &str) -> String {
    format!(
        "name = \"mine\"\nrobots = {{ default = 4, least = 2, most = 6 }}\nhalf_extent_m = [2.0, 3.0]\n\
         rules = {{ arrival_m = 0.25, limit_s = 40.0 }}\n{lines}\n"
    )
}

/// The error of a task file, of its text or of its scenario.
fn error(text: &str) -> Option<String> {
    match TaskFile::read(text) {
        Err(error) => Some(error.to_string()),
        Ok(file) => file.scenario(&Settings::default()).err().map(|error| error.to_string()),
    }
}

#[test]
fn the_contract_of_scenarios_holds_for_every_kind_of_places() {
    let wall = "walls = [{ rect = [-2.0, -0.1, 0.5, 0.1] }]\n";
    let sides = "start = { disc = [0.0, -1.7, 1.0] }\ngoal = { rect = [-1.5, 0.7, 1.5, 2.5] }";
    let obstacles = "obstacles = [{ count = 3, size_m = [0.3, 0.3], within = [-1.5, -1.0, 1.5, 1.0], seed = 7 }]\n";
    let points = |y: f32| format!("{{ points = [[-1.5, {y}], [-0.75, {y}], [0.0, {y}], [0.75, {y}], [1.5, {y}]] }}");
    let formations = format!("start = {}\ngoal = {}", points(-2.0), points(2.0)).replace("], [1.5", "], [1.5");
    let formations = file(&formations).replace("most = 6", "most = 5");
    let places = "places = [[-1.0, -1.0], [0.0, -1.0], [1.0, -1.0], [-1.0, 1.0], [0.0, 1.0], [1.0, 1.0]]";
    let area = "area = { rect = [-2.0, -3.0, 2.0, 3.0] }";
    let anew =
        "obstacles = [{ count = 2, size_m = [0.3, 0.3], within = [-2.0, -3.0, 2.0, 3.0], each_episode = true }]\n";
    let texts = [
        file(&format!("{wall}{sides}")),
        file(&format!("{obstacles}{sides}")),
        formations,
        file(places),
        file(area),
        file(&format!("{wall}{anew}{area}")),
        file(&format!("{anew}{sides}")),
    ];
    for text in texts.iter().map(String::as_str).chain([FOUR_ROOMS, SHAPES]).chain(LIBRARY) {
        let task = TaskFile::read(text).unwrap_or_else(|error| panic!("{error}:\n{text}"));
        contract::check_file(&task).unwrap_or_else(|broken| panic!("{broken}:\n{text}"));
    }
}

#[test]
fn four_rooms_have_four_doors_and_every_robot_changes_its_room() {
    let lines = FOUR_ROOMS.lines().count();
    assert!(lines <= 30, "{lines} lines");
    let task = TaskFile::read(FOUR_ROOMS).expect("it is sound");
    let rooms = task.scenario(&Settings::default()).expect("it is sound");
    assert_eq!((rooms.name(), rooms.robots(), rooms.arena().portals.len()), ("four-rooms", 6, 4));
    let room = |at: [f32; 2]| at.map(|axis| axis > 0.0);
    for (seed, episode) in (0..10).flat_map(|seed| (0..5).map(move |episode| (seed, episode))) {
        for task in rooms.tasks(seed, episode) {
            assert_ne!(room(task.start.to_array()), room(task.goal.to_array()));
            assert!(rooms.distance_to_go(&task, task.start) >= (task.goal - task.start).norm());
        }
    }
}

/// Asserts that a task file with these lines is refused with these words.
fn refused((lines, expected): &(String, &str)) {
    let found = error(&file(lines)).unwrap_or_else(|| panic!("not refused: {lines}"));
    assert!(found.contains(expected), "{lines}\n{found}");
}

#[test]
fn what_cannot_be_is_refused_by_its_field() {
    let sides = "start = { disc = [0.0, -1.7, 1.0] }\ngoal = { rect = [-1.5, 0.7, 1.5, 2.5] }";
    let cases = [
        (String::new(), "start: it is missing: give start and goal, area, exchange, or places"),
        ("start = { disc = [0.0, 0.0, 1.0] }".to_owned(), "goal: it is missing"),
        (format!("{sides}\nplaces = [[0, 0]]"), "places: there is 'start' already"),
        (format!("{sides}\nunlabelled = true"), "unlabelled: unknown field"),
        (format!("{sides}\ngoals = \"free\""), "goals: unknown variant, expected `labelled` or `unlabelled`"),
        (format!("{sides}\nsenses.eyes = {{ rays = 3 }}"), "senses.eyes.kind: it is missing"),
        ("places = [[0, 0]]\ngoals = \"unlabelled\"".to_owned(), "places: robots would stand at unlabelled goals"),
        (
            format!("{sides}\nreward = {{ spread = 1.0 }}"),
            "reward.spread: unknown field `spread`, expected one of `progress`, `arrival`, `contact`, `time`, \
             `nearness`, `energy`, `cohesion`, `matching`, `coverage`",
        ),
        (format!("{sides}\nwalls = [{{ points = [[0, 0]] }}]"), "walls[0]: a wall is a rect, a disc or a polygon"),
        (format!("{sides}\nwalls = [{{ disc = [0, 0, -1] }}]"), "walls[0].disc[2]: -1 is not"),
        (
            format!("{sides}\nwalls = [{{ polygon = [[0, 0], [3, 1], [3, 0], [0, 2]] }}]"),
            "walls[0].polygon: its sides cross or touch each other",
        ),
        (
            format!("{sides}\nwalls = [{{ polygon = [[0, 0], [1, 1]] }}]"),
            "walls[0].polygon: a polygon has three corners",
        ),
        (format!("{sides}\nground = {{ disc = [0, 0, 3] }}"), "ground: there is 'half_extent_m' already"),
        (
            format!("{sides}\nobstacles = [{{ count = 1, within = [-2, -2, 2, 2] }}]"),
            "obstacles[0].size_m: give one of size_m, radius_m and polygon",
        ),
        (
            format!(
                "{sides}\nobstacles = [{{ count = 1, within = [-2, -2, 2, 2], polygon = [[0, 0], [1, 0], [0.1, 0.1], \
                 [0, 1]] }}]"
            ),
            "obstacles[0].polygon: it is not convex",
        ),
        (format!("{sides}\nwalls = [{{ rect = [0, 0, -1, 1] }}]"), "walls[0].rect[0]: the smallest x comes first"),
        (format!("{sides}\nwalls = [{{ rect = [0, 0, nan, 1] }}]"), "walls[0].rect[2]: NaN is not"),
        (
            "start = { disc = [0.0, -1.7, 0.3] }\ngoal = { rect = [-1.5, 0.7, 1.5, 2.5] }".to_owned(),
            "the task 'mine': start: it has room for 2 robots with",
        ),
        (
            "start = { disc = [0.0, -1.0, 1.0] }\ngoal = { disc = [0.0, 1.0, 1.0] }".to_owned(),
            "goal: it is 0.000 m from start",
        ),
        (
            "places = [[-1, 0], [-1, 0.1], [1, 0], [0, 1], [0, 2], [1, 2]]".to_owned(),
            "places[1]: it is 0.100 m from places[0]",
        ),
        ("places = [[-1, 0], [9, 0.1], [1, 0], [0, 1], [0, 2], [1, 2]]".to_owned(), "places[1]: no robot fits there"),
        (
            format!("{sides}\nobstacles = [{{ count = 30, size_m = [1, 1], within = [-2, -2, 2, 2] }}]"),
            "obstacles[0]: there is no room",
        ),
    ];
    cases.iter().for_each(refused);
}

#[test]
fn waypoints_that_cannot_be_are_refused_by_their_place() {
    let sides = "start = { disc = [0.0, -1.7, 1.0] }\ngoal = { rect = [-1.5, 0.7, 1.5, 2.5] }";
    let cases = [
        (
            format!("{sides}\nwaypoints = [{{ points = [[0, 9]] }}]"),
            "waypoints[0]: no robot fits there beside the goals",
        ),
        (format!("{sides}\nwaypoints = [{{ disc = [0, 0, 0] }}]"), "waypoints[0].disc[2]: 0 is not"),
        (
            format!("{sides}\nwaypoints = [{{ disc = [0, 0, 1] }}]\ngoals = \"unlabelled\""),
            "waypoints: a robot passes them before its own goal",
        ),
        (format!("{sides}\nwaypoints = [{}]", "{ points = [[0, 0]] }, ".repeat(17)), "waypoints: there are 17"),
    ];
    cases.iter().for_each(refused);
}

#[test]
fn moving_obstacles_that_cannot_be_are_refused_by_their_fields() {
    let sides = "start = { disc = [0.0, -1.7, 1.0] }\ngoal = { rect = [-1.5, 0.7, 1.5, 2.5] }";
    let mover = |fields: &str| format!("{sides}\nmovers = [{{ {fields} }}]");
    let on = |path: &str, fields: &str| mover(&format!("radius_m = 0.2, speed_m_s = 0.3, path = {path}{fields}"));
    let wall = "\nwalls = [{ rect = [0.0, -0.1, 0.2, 0.1] }]";
    let cases = [
        (mover("radius_m = 0.2, path = [[0, 0], [1, 0]], speed_m_s = 0"), "movers[0].speed_m_s: 0 is not"),
        (mover("radius_m = 0.2, path = [[0, 0], [1, 0]], speed_m_s = 3"), "movers[0].speed_m_s: 3 is not"),
        (mover("path = [[0, 0], [1, 0]], speed_m_s = 0.3"), "movers[0].size_m: give one of size_m, radius_m and"),
        (on("[[0, 0]]", ""), "movers[0].path: there are 1 points, which is not 2 to 64"),
        (on("[[0, 0], [0, 0]]", ""), "movers[0].path[0]: it is not 0.01 m from the next point"),
        (on("[[0, 0], [1, 0], [0, 0]]", ", closed = true"), "movers[0].path[2]: it is not 0.01 m from the next point"),
        (on("[[0, 0], [4, 0]]", ""), "movers[0].path: it leaves the ground at [4.00, 0.00]"),
        (on("[[-1, 0], [1, 0]]", ", phase = 0.5, each_episode = true"), "movers[0].phase: each_episode draws it"),
        (on("[[-1, 0], [1, 0]]", ", phase = 2"), "movers[0].phase: 2 is not"),
        (on("[[-1, 0], [1, 0]]", ", colour = 1"), "movers[0].colour: unknown field"),
        (on("[[0, -2.7], [0, -0.7]]", "").replace("1.0] }\ngoal", "0.4] }\ngoal"), "start: it has room for 0 robots"),
        (format!("{}{}", on("[[-1, 0], [1, 0]]", ""), wall), "movers[0].path: the obstacle runs into walls[0]"),
        (
            format!(
                "{sides}\nmovers = [{}]",
                "{ radius_m = 0.1, path = [[0, 0], [1, 0]], speed_m_s = 0.3 }, ".repeat(17)
            ),
            "movers: there are 17, more than 16",
        ),
        (
            "places = [[0, -2], [0, 0.1], [1, 2], [-1, 2], [1, -2], [-1, -2]]\nmovers = [{ radius_m = 0.2, \
            path = [[-1, 0], [1, 0]], speed_m_s = 0.3 }]"
                .to_owned(),
            "places[1]: no robot may stand there: it keeps 0.250 m from the way of movers[0]",
        ),
    ];
    cases.iter().for_each(refused);
}

#[test]
fn robots_have_the_senses_of_the_task_unless_their_team_says_others() {
    let task = TaskFile::read(NAVIGATION).expect("it is sound");
    let scenario = task.scenario(&Settings::of(4)).expect("it is sound");
    let preset = |mode| Deployment::preset(mode, 4).expect("a preset");
    let trial = Trial::new(preset("onboard-adhoc"), scenario.clone(), Model::Orca);
    trial.check().expect("it is sound");
    let rays = |trial: &Trial| trial.sense_layouts().iter().map(|(_, layout)| layout.floats()).collect::<Vec<_>>();
    assert_eq!(rays(&trial), [24]);
    let carries = |link: &murmurate::deploy::Link| link.carries.contains(&Kind::Sensed);
    assert!(trial.deployment.links.iter().any(carries), "what robots perceive crosses hosts");
    assert_eq!(trial.deployment.clone().for_task(Some(&task)), trial.deployment, "they are added once");
    let own = senses_of("[senses.eyes]\nkind = \"lidar\"\nrays = 5\nrange_m = 1.0").expect("they are senses");
    let trial = Trial::new(preset("sim").with_senses(own), scenario, Model::Orca);
    assert_eq!(rays(&trial), [5]);
    let registry = Registry::builtin().with_task("mine.toml", task);
    let team = |senses: &str| {
        let text = format!("team = 1\nmode = \"offboard\"\nscenario = \"mine.toml\"\n{senses}");
        let file = TeamFile::read(
            &registry.clone().reading_tasks(|_| Ok(NAVIGATION.to_owned())),
            &text,
            Path::new(""),
            &[],
            &[],
        );
        file.expect("it is sound").deployment().senses["eyes"].kind.clone()
    };
    assert_eq!(team(""), "lidar");
    assert_eq!(team("[senses.eyes]\nkind = \"relative\"\nmost = 3\nrange_m = 1.0\n"), "relative");
}

#[test]
fn senses_of_a_task_that_the_program_does_not_have_are_refused_by_their_names() {
    for (from, to, expected) in [
        ("\"lidar\"", "\"nose\"", "senses.eyes.kind: there is no kind of sense 'nose'"),
        ("rays = 24", "rays = 0", "senses.eyes.rays: 0 is not"),
        ("noise_m", "colour", "senses.eyes.colour: unknown field"),
    ] {
        let task = TaskFile::read(&NAVIGATION.replace(from, to)).expect("kinds are those of a registry");
        let error = Registry::builtin().check_senses(&task).expect_err(expected).to_string();
        assert!(error.starts_with(expected), "{error}");
    }
}

/// Paths of all values of a table, of lists and tables, too.
fn paths(value: &Value, at: &[String]) -> Vec<Vec<String>> {
    let below: Vec<(String, &Value)> = match value {
        Value::Table(table) => table.iter().map(|(name, value)| (name.clone(), value)).collect(),
        Value::Array(list) => list.iter().enumerate().map(|(at, value)| (at.to_string(), value)).collect(),
        _ => Vec::new(),
    };
    let all = below.into_iter().map(|(name, value)| ([at, &[name]].concat(), value));
    all.flat_map(|(path, value)| [vec![path.clone()], paths(value, &path)].concat()).collect()
}

/// Puts another value at a path, or removes what is there.
fn changed(mut whole: Value, path: &[String], to: Option<Value>) -> Value {
    let (last, before) = path.split_last().expect("a path has a step");
    let mut into = &mut whole;
    for step in before {
        into = match into {
            Value::Table(table) => table.get_mut(step).expect("it is there"),
            Value::Array(list) => &mut list[step.parse::<usize>().expect("an index")],
            other => panic!("{other} has no fields"),
        };
    }
    match (into, to) {
        (Value::Table(table), Some(to)) => drop(table.insert(last.clone(), to)),
        (Value::Table(table), None) => drop(table.remove(last)),
        (Value::Array(list), Some(to)) => list[last.parse::<usize>().expect("an index")] = to,
        (Value::Array(list), None) => drop(list.remove(last.parse().expect("an index"))),
        (other, _) => panic!("{other} has no fields"),
    }
    whole
}

#[test]
fn every_mutation_of_a_task_file_is_accepted_or_refused_in_a_line_that_names_a_field() {
    let (tried, refused) = mutations(FOUR_ROOMS, "exchange");
    assert!(tried > 600 && refused > 200, "{refused} of {tried} mutations are refused");
    // Places of robots, walls or obstacles may leave no room in an area.
    let (tried, refused) = mutations(SHAPES, "start");
    assert!(tried > 600 && refused > 200, "{refused} of {tried} mutations are refused");
}

/// Tries mutations of a task file, and returns how many, and how many of them are refused. An error may name the field
/// `area` in place of that which was changed.
fn mutations(text: &str, area: &str) -> (usize, usize) {
    let whole: Value = Value::Table(text.parse::<Table>().expect("it is TOML"));
    let numbers = [f64::NAN, f64::INFINITY, -1.0, 0.0, 1e300, 1e-300, 5000.0].map(Value::Float);
    let others = [
        Value::String("many".to_owned()),
        Value::String("\u{1b}[2J\n".to_owned()),
        Value::Boolean(true),
        Value::Integer(i64::MAX),
        Value::Integer(-1),
        Value::Array(Vec::new()),
        Value::Table(Table::new()),
    ];
    let (mut refused, mut tried) = (0, 0);
    for path in paths(&whole, &[]) {
        let unknown =
            matches!(at(&whole, &path), Value::Table(_)).then(|| [&path[..], &["colour".to_owned()]].concat());
        let values = numbers.iter().chain(&others).map(|value| (path.clone(), Some(value.clone())));
        let all = values.chain([(path.clone(), None)]).chain(unknown.map(|path| (path, Some(Value::Boolean(true)))));
        for (path, to) in all {
            tried += 1;
            let text = toml::to_string(&changed(whole.clone(), &path, to)).expect("it is TOML");
            let Some(found) = error(&text) else { continue };
            refused += 1;
            assert_eq!(printable(&found, Layout::Line), found, "one line, without control characters");
            // A size of ground, robots or walls may leave no room in an area.
            let named =
                [path[0].as_str(), area, "goal", "obstacles", "movers"].iter().any(|field| found.contains(field));
            assert!(named && found.len() < 400, "{path:?}: {found}\n{text}");
        }
    }
    (tried, refused)
}

fn at<'a>(whole: &'a Value, path: &[String]) -> &'a Value {
    path.iter().fold(whole, |value, step| match value {
        Value::Array(list) => &list[step.parse::<usize>().expect("an index")],
        value => &value[step.as_str()],
    })
}
