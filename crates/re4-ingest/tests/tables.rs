//! Tables of older artifacts are read into the current row types.
#![allow(clippy::unwrap_used, missing_docs, reason = "a test may stop where it fails")]

use nalgebra::{Isometry3, Translation3, UnitQuaternion};
use re4_artifact::{Artifact, ArtifactSummary, Label, Recipe, Row, SixAxis, Stage, Store, table};
use re4_geometry::{Point2, Pose2};
use re4_ingest::{FrameRow, ImageRow, PlanarColumns, SpatialColumns};

table! {
    /// Spatial frames of version 1.
    #[table("spatial_frames", version = 1)]
    pub struct OldSpatial {
        /// Demonstration.
        pub episode: u32,
        /// Frame.
        pub frame: u32,
        /// End effector.
        pub eef: Isometry3<f64>,
        /// Object.
        pub object: Isometry3<f64>,
        /// Fingers.
        #[prefix = "finger"]
        pub fingers: [f64; 2],
        /// Delta action.
        pub delta: SixAxis,
        /// Absolute action.
        pub goal: SixAxis,
        /// Gripper command.
        pub gripper: f64,
        /// Reward.
        pub reward: Option<f64>,
        /// Done.
        pub done: Option<bool>,
    }
}

table! {
    /// Planar frames of version 1.
    #[table("frames", version = 1)]
    pub struct OldPlanar {
        /// Demonstration.
        pub episode: u32,
        /// Frame.
        pub frame: u32,
        /// End effector.
        pub eef: Point2,
        /// Object.
        pub object: Pose2,
        /// Action.
        pub action: Point2,
        /// Contacts.
        pub contacts: Option<f64>,
        /// Keypoints.
        #[prefix = "keypoint"]
        pub keypoints: [Option<Point2>; 9],
    }
}

table! {
    /// Push-T images of version 1.
    #[table("images", version = 1)]
    pub struct OldImage {
        /// Demonstration.
        pub episode: u32,
        /// Frame.
        pub frame: u32,
        /// PNG file.
        pub image: Vec<u8>,
    }
}

table! {
    /// Camera images of version 1.
    #[table("camera_images", version = 1)]
    pub struct OldCameraImage {
        /// Camera.
        pub camera: Label,
        /// Demonstration.
        pub episode: u32,
        /// Frame.
        pub frame: u32,
        /// PNG file.
        pub image: Vec<u8>,
    }
}

/// An artifact that contains only this row.
fn artifact_with<R: Row>(row: R) -> (tempfile::TempDir, Artifact) {
    let folder = tempfile::tempdir().unwrap();
    let store = Store::open(folder.path()).unwrap();
    let recipe = Recipe::new(Stage::Ingest, 1).config(&serde_json::json!({})).unwrap();
    let writer = store.begin(&recipe).unwrap();
    writer.write_rows([row]).unwrap();
    (folder, writer.publish(ArtifactSummary::default()).unwrap())
}

fn pose(x: f64) -> Isometry3<f64> {
    Isometry3::from_parts(
        Translation3::new(x, 0.25, 0.5),
        UnitQuaternion::from_euler_angles(0.1, 0.2, x),
    )
}

#[test]
fn version_1_spatial_frames_are_read() {
    let (_folder, artifact) = artifact_with(OldSpatial {
        episode: 3,
        frame: 7,
        eef: pose(1.0),
        object: pose(2.0),
        fingers: [0.02, -0.02],
        delta: SixAxis([0.1; 6]),
        goal: SixAxis([0.2; 6]),
        gripper: -1.0,
        reward: Some(1.0),
        done: None,
    });
    let rows: Vec<FrameRow<SpatialColumns>> = artifact.read().unwrap();
    let [
        FrameRow {
            episode: 3,
            frame: 7,
            recorded,
        },
    ] = &rows[..]
    else {
        unreachable!("{rows:?}")
    };
    assert_eq!((recorded.eef, recorded.object), (pose(1.0), Some(pose(2.0))));
    assert_eq!((recorded.raw_eef, recorded.raw_gripper), (None, None));
    let frame = recorded.frame().unwrap();
    assert_eq!((frame.delta, frame.goal, frame.closes()), ([0.1; 6], [0.2; 6], false));
    // A frame without an object is not a complete frame.
    let without = SpatialColumns {
        object: None,
        ..recorded.clone()
    };
    assert_eq!(without.frame(), None);
}

#[test]
fn version_1_planar_frames_are_read() {
    let object = Pose2::new(250.0, 260.0, 1.5);
    let mut row = OldPlanar {
        episode: 0,
        frame: 1,
        eef: Point2::new(10.0, 20.0),
        object,
        action: Point2::new(11.0, 21.0),
        contacts: None,
        keypoints: [None; 9],
    };
    let read = |row: OldPlanar| {
        let (_folder, artifact) = artifact_with(row);
        let rows: Vec<FrameRow<PlanarColumns>> = artifact.read().unwrap();
        rows.into_iter().next().unwrap().recorded
    };
    let recorded = read(row.clone());
    assert_eq!((recorded.object, recorded.keypoints), (Some(object), None));
    assert_eq!(recorded.contacts, None);
    row.keypoints = [Some(Point2::new(1.0, 2.0)); 9];
    assert_eq!(read(row).keypoints, Some([Point2::new(1.0, 2.0); 9]));
}

#[test]
fn version_1_images_are_read() {
    let (_folder, artifact) = artifact_with(OldImage {
        episode: 1,
        frame: 2,
        image: vec![1, 2, 3],
    });
    let rows: Vec<ImageRow> = artifact.read().unwrap();
    assert_eq!((rows[0].episode, rows[0].frame, rows[0].camera.clone()), (1, 2, None));
    let (_folder, artifact) = artifact_with(OldCameraImage {
        camera: "agentview".into(),
        episode: 1,
        frame: 2,
        image: vec![4],
    });
    let rows: Vec<ImageRow> = artifact.read().unwrap();
    assert_eq!(rows[0].camera.as_deref(), Some("agentview"));
    assert_eq!(rows[0].image, [4]);
}
