//! Comparison of poses from states with robosuite's observations, on real files.
#![allow(clippy::unwrap_used, clippy::print_stdout, reason = "tests may panic")]

mod common;

use common::{TASKS, dataset, scripted, text_attribute};
use nalgebra::Vector3;
use re4_robosuite::conventions::QuaternionOrder;
use re4_robosuite::kinematics::Model;

#[test]
fn poses_equal_the_observations_of_all_scripted_demonstrations() {
    for task in TASKS {
        let Some(source) = scripted(task, "low_dim.hdf5") else {
            return;
        };
        let object = match task {
            "lift" => "cube",
            "can" => "Can",
            _ => "SquareNut",
        };
        let [
            mut eef,
            mut rotation_error,
            mut gripper,
            mut position,
            mut object_rotation,
        ] = [0.0_f64; 5];
        let mut frames = 0;
        let names = source.names();
        assert_eq!(names.len(), 200);
        for name in names {
            let demo = source.demo(&name);
            let arrays = demo.arrays();
            let observed = demo.model.observe(arrays.states.unwrap().rows(), Some(object)).unwrap();
            for (t, known) in observed.iter().enumerate() {
                let row = arrays.object.unwrap().row(t);
                let rotation = |q: &[f64]| QuaternionOrder::Xyzw.rotation(q.try_into().unwrap()).unwrap();
                eef = eef.max((known.site.translation.vector - Vector3::from(demo.eef_pos[t])).norm());
                rotation_error = rotation_error.max(known.hand.rotation.angle_to(&rotation(&demo.eef_quat[t])));
                let fingers = known.gripper_qpos.unwrap();
                gripper = gripper.max((fingers[0] - demo.gripper_qpos[t][0]).abs());
                gripper = gripper.max((fingers[1] - demo.gripper_qpos[t][1]).abs());
                let pose = known.object.unwrap();
                position = position.max((pose.translation.vector - Vector3::from_column_slice(&row[..3])).norm());
                object_rotation = object_rotation.max(pose.rotation.angle_to(&rotation(&row[3..7])));
                frames += 1;
            }
        }
        println!(
            "{task}: {frames} frames, eef {eef:.1e} m {rotation_error:.1e} rad, gripper {gripper:.1e} m, object {position:.1e} m {object_rotation:.1e} rad"
        );
        for worst in [eef, rotation_error, gripper, position, object_rotation] {
            assert!(worst <= 1e-9, "{task}: {worst:e}");
        }
    }
}

#[test]
fn models_of_other_versions_are_parsed() {
    // The widths of the states and the names of the free bodies that belong to each model.
    let models = [
        ("robosuite-1.0.1-demos/lift/panda", 32, vec!["cube"]),
        ("robosuite-1.0.1-demos/stack/panda", 45, vec!["cubeA", "cubeB"]),
        (
            "robosuite-1.0.1-demos/nut-assembly/panda",
            45,
            vec!["SquareNut0", "RoundNut0"],
        ),
        (
            "robosuite-1.0.1-demos/pick-place/panda",
            71,
            vec!["Milk0", "Bread0", "Cereal0", "Can0"],
        ),
        ("robosuite-1.0.1-demos/door/panda", 23, vec![]),
        ("robosuite-1.0.1-demos/wipe/panda", 15, vec![]),
    ];
    for (folder, width, free) in models {
        let Some(path) = dataset(&format!("robosuite/{folder}/models/model_1.xml")) else {
            return;
        };
        let model = Model::parse(&std::fs::read_to_string(path).unwrap()).unwrap();
        let names: Vec<&str> = model.free_bodies().map(|(_, name)| name).collect();
        assert_eq!((model.state_width(), names), (width, free), "{folder}");
        let robot = model.robot(0).unwrap();
        assert_eq!(model.site_name(robot.grip_site), "gripper0_grip_site");
        assert_eq!(model.body_name(robot.hand), "robot0_right_hand");
        assert_eq!(robot.fingers.is_some(), !folder.contains("wipe"), "{folder}");
    }
    let file = dataset("robosuite/robosuite-1.4.1-demos/handover/panda_panda/demo.hdf5").unwrap();
    let model = Model::parse(&text_attribute(&file, "data/demo_0", "model_file")).unwrap();
    let (left, right) = (model.robot(0).unwrap(), model.robot(1).unwrap());
    assert_eq!((left.fingers, right.fingers), (Some([7, 8]), Some([16, 17])));
    assert!(
        model.object("hammer").unwrap_err().to_string().contains("hammer_root"),
        "the body is named hammer_root"
    );
}
