//! Rewriting the paths of a model's meshes and textures to paths on this machine.
#![allow(clippy::unwrap_used, reason = "tests may panic")]

use std::fs;
use std::path::Path;

use re4_robosuite::models::{AssetsError, split_appearance, with_assets};

fn model(file: &str) -> String {
    format!("<mujoco>\n  <asset><mesh name=\"a\" file='{file}'/></asset> <!-- kept -->\n</mujoco>\n")
}

/// A folder with one mesh and one texture. Its name contains characters that must be escaped in XML.
fn folder() -> (tempfile::TempDir, std::path::PathBuf) {
    let holder = tempfile::tempdir().unwrap();
    let folder = holder.path().join("a & 'b\"");
    for file in ["models/assets/meshes/a.stl", "models/assets/textures/b.png"] {
        fs::create_dir_all(folder.join(file).parent().unwrap()).unwrap();
        fs::write(folder.join(file), b"").unwrap();
    }
    (holder, folder)
}

fn written(text: &str) -> Vec<String> {
    let document = roxmltree::Document::parse(text).unwrap();
    let nodes = document.descendants();
    nodes
        .filter_map(|node| node.attribute("file").map(str::to_owned))
        .collect()
}

#[test]
fn paths_are_rewritten_after_the_last_robosuite_and_the_rest_is_kept() {
    let (_holder, folder) = folder();
    let mesh = folder.join("models/assets/meshes/a.stl");
    let texture = folder.join("models/assets/textures/b.png");
    for (named, place) in [
        ("/home/x/robosuite/robosuite/models/assets/meshes/a.stl", &mesh),
        ("/robosuite/models/assets/arenas/../textures/b.png", &texture),
        ("../robosuite//models/./assets/meshes/a.stl", &mesh),
        (r"C:\Users\x\robosuite\models\assets\meshes\a.stl", &mesh),
        (r"C:\x\robosuite\models\assets/arenas/..\textures/b.png", &texture),
    ] {
        let before = model(named);
        let after = with_assets(&before, &folder).unwrap();
        assert_eq!(written(&after), [place.to_str().unwrap()]);
        let (left, right) = before.split_once(named).unwrap();
        assert!(after.starts_with(left) && after.ends_with(right), "{after}");
    }
    let none = "<mujoco><asset><texture builtin=\"flat\" file=\"\"/></asset></mujoco>";
    assert_eq!(with_assets(none, &folder).unwrap(), none);
}

#[test]
fn files_that_cannot_be_found_are_errors() {
    let (_holder, folder) = folder();
    let refused = |text: &str| with_assets(text, &folder).unwrap_err();
    assert!(matches!(
        refused(&model("/a/robosuite/models/assets/meshes/c.stl")),
        AssetsError::Missing { path, .. } if path == folder.join("models/assets/meshes/c.stl")
    ));
    // A folder is not a file.
    assert!(matches!(
        refused(&model("/a/robosuite/models")),
        AssetsError::Missing { .. }
    ));
    for foreign in ["/a/robosuites/x.stl", "x.stl", "/a/robosuite/models/../../x.stl"] {
        assert_eq!(refused(&model(foreign)), AssetsError::Foreign(foreign.to_owned()));
    }
    assert!(matches!(refused("<mujoco>"), AssetsError::Xml(_)));
    assert_eq!(refused("<robot/>"), AssetsError::Root("robot".to_owned()));
    let include = "<mujoco><include file=\"/a/robosuite/models/assets/meshes/a.stl\"/></mujoco>";
    assert!(matches!(refused(include), AssetsError::Include(_)));
    assert!(!Path::new("x.stl").exists());
}

#[test]
fn models_that_differ_only_in_box_sizes_have_the_same_rest() {
    let model = |mean: &str, size: &str| {
        format!(
            "<mujoco><statistic meansize=\"{mean}\" extent=\"2\"/><geom name=\"a\" type=\"box\" size=\"{size}\"/><geom type=\"box\" size=\"1 1 1\"/><geom name=\"b\" size=\"3\"/></mujoco>"
        )
    };
    let [one, other] =
        [model("0.2", "0.1 0.2 0.3"), model("0.3", "1 2 3e-1")].map(|text| split_appearance(&text).unwrap());
    assert_eq!(one.rest, other.rest);
    assert_eq!(one.boxes, [("a".to_owned(), [0.1, 0.2, 0.3])]);
    assert_eq!(other.boxes, [("a".to_owned(), [1.0, 2.0, 0.3])]);
    // Boxes without a name or with a size of other than three numbers are part of the rest, like everything else.
    assert!(
        one.rest.contains("size=\"1 1 1\"") && one.rest.contains("size=\"3\"") && one.rest.contains("extent=\"2\"")
    );
    assert_ne!(split_appearance(&model("0.2", "0.1 0.2")).unwrap().rest, one.rest);
}
