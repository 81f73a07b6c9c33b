//! Two nodes with a mount of one network file system each, one of which is lost or hangs: `tests/network_mounts.py` on small datasets.
//!
//! Needs root, `/dev/fuse` and GlusterFS from Debian, which `scripts/setup-engines.sh` installs; otherwise the tests report that they are
//! skipped.

use std::path::Path;
use std::process::Command;

use crate::support::{Answer, PROGRAM, Place, repository};

/// Runs the tasks of a plan on two nodes, and disturbs one of them in the middle of a task of this group.
fn disturbed(place: &Place, pipeline: &str, data: &Path, group: &str, more: &[&str]) {
    let output = Command::new("python3")
        .arg(repository().join("tests/network_mounts.py"))
        .arg(PROGRAM)
        .arg(place.path().join(pipeline))
        .arg(data)
        .arg(place.path().join(group))
        .args(["--disturb", group])
        .args(more)
        .env("PYTHONDONTWRITEBYTECODE", "1")
        .output()
        .unwrap();
    let answer = Answer::new(&output, place.path()).done();
    println!("{}", answer.stdout);
    if answer.stdout.starts_with("skipped: ") {
        return;
    }
    let same = answer.stdout.lines().filter(|line| line.contains(" s, same bytes"));
    assert_eq!(same.count(), 3, "{}", answer.stdout);
    assert!(
        answer
            .stdout
            .contains("unfinished folder of node 1 kept by node 2, removed by node 1")
    );
    assert!(answer.stdout.contains("the task that hung ended with 0"));
}

#[test]
fn rollouts_on_two_mounts_have_the_bytes_of_one_process() {
    let place = Place::new();
    let more = ["--shards", "3", "--seeds", "300000..306000", "--max-steps", "4"];
    disturbed(&place, "small.toml", &place.path().join("data"), "rollout", &more);
}

#[test]
fn many_demonstrations_on_two_mounts_have_the_bytes_of_one_process() {
    let Some(python) = std::env::var_os("RE4_PYTHON") else {
        println!("skipped: RE4_PYTHON is not set; run scripts/setup-python.sh and set it to target/python/bin/python");
        return;
    };
    let place = Place::empty();
    let made = Command::new(python)
        .arg(repository().join("tests/make_many.py"))
        .args([repository().join("data/can-sample.hdf5"), place.path().join("data")])
        .arg("1200")
        .status();
    assert!(made.unwrap().success());
    place.write(
        "many.toml",
        "task = \"can\"\nvariant = \"state\"\n[ingest]\nsource = \"many.hdf5\"\n[segment]\n[index]\n[pose]\nsource = \"recorded\"\n\
         [policy]\nkind = \"paper\"\n[rollout]\nseeds = \"0..300\"\n",
    );
    let more = ["--shards", "2", "--stages", "ingest,segment,observe,audit,index"];
    for group in ["ingest", "index"] {
        disturbed(&place, "many.toml", &place.path().join("data"), group, &more);
    }
}
