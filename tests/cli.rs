//! The command line and the pipeline file: help, version, and all error messages.

use crate::support::{Answer, Place};
use insta::assert_snapshot;
use re4_policy::kinds::{Kinds as _, PlanePolicy};
use re4_stages::Task;

/// The subcommands that `--help` lists.
pub(crate) const COMMANDS: [&str; 27] = [
    "ingest",
    "segment",
    "observe",
    "audit",
    "train-encoder",
    "train-pose",
    "index",
    "train",
    "scenes",
    "rollout",
    "run",
    "merge",
    "plan",
    "status",
    "compare",
    "influence",
    "curate",
    "replay",
    "video",
    "verify",
    "inspect",
    "query",
    "export",
    "report",
    "fetch",
    "doctor",
    "schemas",
];

#[test]
fn help_of_the_program_and_of_every_subcommand() {
    let place = Place::empty();
    let help = place.run("--help").done();
    assert_eq!(help.stderr, "");
    assert_snapshot!("help", help.stdout);
    let listed: Vec<&str> = help
        .stdout
        .lines()
        .skip_while(|line| *line != "Commands:")
        .skip(1)
        .map_while(|line| line.strip_prefix("  "))
        .filter(|line| !line.starts_with(' '))
        .filter_map(|line| line.split_whitespace().next())
        .filter(|word| *word != "help")
        .collect();
    assert_eq!(listed, COMMANDS);
    for command in COMMANDS {
        let help = place.run(&format!("{command} --help")).done();
        assert_eq!(help.stderr, "");
        assert_snapshot!(format!("help_{command}"), help.stdout);
    }
}

/// Log lines go to standard error with `-v`, `-vv` or the environment variable, and standard output does not change.
#[test]
fn log_lines_are_printed_on_request() {
    let place = Place::new();
    let logged = |answer: &Answer| answer.stderr.matches(" re4_stages::").count();
    let plain = place.run("segment small.toml").done();
    assert_eq!(logged(&plain), 0, "{}", plain.stderr);
    let info = place.run("segment small.toml -v").done();
    assert!(
        info.stderr.contains("INFO") && info.stderr.contains("artifact exists") && !info.stderr.contains("DEBUG"),
        "{}",
        info.stderr
    );
    let more = place.run("-vv segment small.toml").done();
    assert!(
        more.stderr.contains("DEBUG") && logged(&more) > logged(&info),
        "{}",
        more.stderr
    );
    assert_eq!((&info.stdout, &more.stdout), (&plain.stdout, &plain.stdout));
    let named = |filter: &str| {
        let output = place
            .command()
            .args(["segment", "small.toml"])
            .env("RUST_LOG", filter)
            .output();
        Answer::new(&output.unwrap(), place.path()).done()
    };
    assert!(logged(&named("re4_stages=debug")) > logged(&info));
    assert_eq!(logged(&named("re4_stages=warn")), 0);
    // A value that is meant for another program does not stop this one.
    assert_eq!(logged(&named("[span{a=1}]=")), 0);
}

/// On standard error, an error and its remedy are one sentence; with `--json` they are two fields.
#[test]
fn errors_have_a_remedy() {
    let place = Place::empty();
    let answer = place.run("run missing.toml --json");
    let what = "cannot read the pipeline file missing.toml: No such file or directory (os error 2)";
    let remedy = "give the path of a TOML file such as pipelines/demo.toml";
    assert_eq!(answer.code, Some(2));
    assert_eq!(answer.stderr, format!("error: {what}; {remedy}\n"));
    assert_eq!(answer.json(), serde_json::json!({ "error": what, "remedy": remedy }));
}

#[test]
fn version() {
    let place = Place::empty();
    let expected = format!("re4-pipe {}\n", env!("CARGO_PKG_VERSION"));
    assert_eq!(place.run("--version").done().stdout, expected);
}

#[test]
fn no_subcommand_shows_the_help_and_fails() {
    let answer = Place::empty().run("");
    assert_eq!((answer.code, answer.stdout.as_str()), (Some(2), ""));
    assert!(
        answer.stderr.contains("Usage: re4-pipe [OPTIONS] <COMMAND>"),
        "{}",
        answer.stderr
    );
}

#[test]
fn errors_of_the_command_line() {
    let place = Place::empty();
    let sentences: Vec<String> = [
        "ingst small.toml",
        "run",
        "run small.toml more",
        "run small.toml --artefacts x",
        "run small.toml --jobs 0",
        "run small.toml --jobs many",
        "run small.toml --jobs 1025",
        "run small.toml --jobs -1",
        "run small.toml --set",
        "run small.toml --max-steps 1.5",
        "video x out.gif",
        "video x --seed 500",
        "video x out.gif --seeds 5..5",
        "video x out.gif --seed 500 --size small",
        "inspect",
        "inspect x --seed 500",
        "inspect x --rows -1",
        "report",
        "train-pose small.toml",
    ]
    .into_iter()
    .map(|arguments| format!("re4-pipe {arguments}\n  {}", place.run(arguments).refused_at_once()))
    .collect();
    assert_snapshot!(kinds_aside(&sentences));
    assert!(!place.artifacts().join("episodes").exists());
}

/// Snapshots the messages without the list of policy kinds, so that a new kind does not change the snapshot.
fn kinds_aside(sentences: &[String]) -> String {
    sentences.join("\n").replace(&PlanePolicy::NAMES.join(", "), "[kinds]")
}

#[test]
fn errors_of_overrides() {
    let place = Place::empty();
    let sentences: Vec<String> = [
        "seeds",
        "=3",
        "rollout..seeds=3",
        "rollot.seeds=3",
        "rollout.sedes=3",
        "ingest.sorce=x",
        "rollout.replan.planer=rrt",
        "anything=1",
        "task=robomimic",
        "variant=image",
        "pose.source=trained",
        "segment.rule=never",
        "ingest.images=maybe",
        "ingest.select.frist=3",
        "ingest.select={first=3,last=3}",
        "ingest.select.range=3-5",
        "index.longest_chunk=long",
        "index.longest_chunk=0",
        "rollout=3",
        "rollout.policy=re44",
        "rollout.policy=3",
        "rollout.seed_scheme=numpy",
        "rollout.reset=old",
        "rollout.seeds=",
        "rollout.seeds=five",
        "rollout.seeds=5..5",
        "rollout.seeds=5..3",
        "rollout.seeds=1,1",
        "rollout.seeds=1..4,3",
        "rollout.seeds=[1,1]",
        "rollout.seeds=-1",
        "rollout.seeds=1.5",
        "rollout.seeds=4294967296",
        "rollout.seeds=0..4294967295",
        "rollout.max_steps=0",
        "rollout.max_steps=-1",
        "rollout.max_steps=many",
        "rollout.replan=3",
        "rollout.replan.planner=rtt",
        "rollout.replan.spacing=0",
        "rollout.replan.step=-1",
        "rollout.replan.goal_bias=1.5",
        "rollout.replan.iterations=0",
        "rollout.retrieve.candidates=0",
        "rollout.retrieve.epsilon=nan",
        "rollout.retrieve.epsilon=-0.5",
        "rollout.replay.horizon=0",
        "rollout.replay.stride=0",
        "rollout.replay.speed=0",
    ]
    .into_iter()
    .map(|text| {
        let sentence = place.run_each(&["run", "small.toml", "--set", text]).refused_at_once();
        format!("--set {text}\n  {sentence}")
    })
    .collect();
    // The list of tasks is filtered, so that a new task does not change the snapshot.
    let tasks: Vec<String> = Task::all().map(|task| format!("`{}`", task.name())).collect();
    assert_snapshot!(kinds_aside(&sentences).replace(&tasks.join(", "), "[tasks]"));
}

#[test]
fn flags_are_checked_like_overrides() {
    let place = Place::empty();
    let error_of = |flag: &str| place.run(&format!("run small.toml {flag}")).refused_at_once();
    let sentences = [
        "--seeds 5..5",
        "--seeds 7,7",
        "--seeds x",
        "--policy re5",
        "--max-steps 0",
    ]
    .map(error_of);
    assert_snapshot!(kinds_aside(&sentences));
}

#[test]
fn errors_of_the_pipeline_file() {
    let place = Place::empty();
    let small = std::fs::read_to_string(place.path().join("small.toml")).unwrap();
    let files = [
        ("not TOML", "task = pusht\n".to_owned()),
        ("a table left open", small.replace("[pose]", "[pose")),
        (
            "a key twice",
            small.replace("[pose]\n", "[pose]\nsource = \"recorded\"\n"),
        ),
        ("nothing", String::new()),
        ("a table missing", small.replace("[pose]\nsource = \"recorded\"\n", "")),
        ("a key missing", small.replace("seeds = \"500..506\"\n", "")),
        ("an unknown table", format!("{small}\n[report]\n")),
        ("a misspelt table", small.replace("[segment]", "[segments]")),
        ("a misspelt key", small.replace("longest_chunk", "longst_chunk")),
        (
            "a misspelt key in a table of the policy",
            format!("{small}\n[rollout.retrieve]\nepsilom = 1\n"),
        ),
        (
            "a word for a number",
            small.replace("max_steps = 60", "max_steps = \"sixty\""),
        ),
        ("a number for a word", small.replace("\"re4\"", "4")),
        (
            "a value for a table",
            small
                .replace("[pose]\nsource = \"recorded\"\n", "")
                .replace("task", "pose = 1\ntask"),
        ),
        ("an unknown preset", small.replace("\"re4\"", "\"papers\"")),
        ("empty seeds", small.replace("500..506", "506..506")),
        ("repeated seeds", small.replace("\"500..506\"", "[500, 501, 500]")),
    ];
    let mut sentences = Vec::new();
    for (what, text) in files {
        place.write("bad.toml", text);
        sentences.push(format!("{what}\n  {}", place.run("run bad.toml").refused_at_once()));
    }
    place.write("bad.toml", b"task = \"\xff\"");
    sentences.push(format!("not UTF-8\n  {}", place.run("run bad.toml").refused_at_once()));
    sentences.push(format!("no file\n  {}", place.run("run absent.toml").refused_at_once()));
    sentences.push(format!("a folder\n  {}", place.run("run data").refused_at_once()));
    assert_snapshot!(kinds_aside(&sentences));
}

#[test]
fn every_stage_command_checks_the_pipeline_file() {
    let place = Place::empty();
    place.write("bad.toml", "tusk = \"pusht\"\n");
    for command in [
        "ingest",
        "segment",
        "train-encoder",
        "train-pose",
        "index",
        "rollout",
        "run",
        "replay",
    ] {
        let sentence = place.run(&format!("{command} bad.toml")).refused_at_once();
        assert!(
            sentence.contains("unknown key tusk (did you mean task?)"),
            "{command}: {sentence}"
        );
    }
}
