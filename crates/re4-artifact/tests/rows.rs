//! Typed rows are read back: whole rows, some of their columns, and rows of older versions of a table.
#![allow(clippy::unwrap_used, clippy::panic, missing_docs, reason = "tests fail by panicking")]

use nalgebra::{Isometry3, Translation3, UnitQuaternion, Vector3};
use re4_artifact::{
    Artifact, ArtifactError, ArtifactSummary, ColumnKind, Label, Recipe, Row, SixAxis, Stage, Store, Word, Writer,
    columns, table,
};
use re4_episode::Mode;
use re4_geometry::{Point2, Pose2};

table! {
    /// One row per measurement, described
    /// over two lines.
    #[table("measurements", version = 1)]
    pub struct OldRow {
        /// Demonstration.
        pub episode: u32,
        /// Word.
        pub word: Label,
        /// Where it was.
        #[frame = "world"]
        pub place: Option<Vector3<f64>>,
    }
}

columns! {
    /// Columns of their own names.
    #[derive(Copy)]
    pub struct Identity {
        /// Demonstration.
        pub episode: u32,
        /// Frame.
        #[since = 2]
        pub frame: Option<u32>,
    }
}

table! {
    /// One row per measurement of everything.
    #[table("figures", version = 2, formerly = "measurements")]
    pub struct NewRow<D> {
        /// Which one.
        #[prefix = ""]
        pub id: Identity,
        /// Word.
        #[formerly = "word"]
        pub mode: Mode,
        /// Pose of the object.
        #[frame = "world"]
        #[formerly = "place"]
        pub object: Option<Vector3<f64>>,
        /// What a domain adds.
        #[since = 2]
        pub more: Option<D>,
    }
}

table! {
    /// One row with a cell of every type.
    #[table("everything", version = 1)]
    pub struct Everything {
        /// Number.
        pub a: u32,
        /// Number.
        pub b: u64,
        /// Number.
        pub c: i64,
        /// Number.
        #[unit = "px/s"]
        pub d: Option<f64>,
        /// Flag.
        pub e: Option<bool>,
        /// Text.
        pub f: Option<String>,
        /// Bytes.
        pub g: Vec<u8>,
        /// Numbers.
        pub h: Vec<f64>,
        /// Numbers.
        pub i: Vec<f32>,
        /// Mode.
        pub j: Option<Mode>,
        /// Pose.
        pub k: Pose2,
        /// Pose.
        #[frame = "world"]
        pub l: Option<Isometry3<f64>>,
        /// Action.
        #[unit = "output_max"]
        pub m: SixAxis,
        /// Fingers.
        #[unit = "m"]
        pub finger: [f64; 2],
        /// Keypoints.
        pub keypoint: Option<[Point2; 2]>,
    }
}

fn everything(full: bool) -> Everything {
    let pose = Isometry3::from_parts(
        Translation3::new(-0.0, 1.0 / 3.0, 2.0),
        UnitQuaternion::from_euler_angles(0.1, -0.2, 0.3),
    );
    Everything {
        a: 1,
        b: u64::MAX,
        c: i64::MIN,
        d: full.then_some(f64::MIN_POSITIVE),
        e: full.then_some(false),
        f: full.then(|| "text".to_owned()),
        g: vec![1, 2, 3],
        h: if full { vec![0.1, -0.0] } else { Vec::new() },
        i: vec![0.5],
        j: full.then_some(Mode::Transfer),
        k: Pose2::new(1.0, 2.0, 3.0),
        l: full.then_some(pose),
        m: SixAxis([1.0, 2.0, 3.0, 4.0, 5.0, 6.0]),
        finger: [0.04, -0.04],
        keypoint: full.then(|| [Point2::new(1.0, 2.0), Point2::new(3.0, 4.0)]),
    }
}

fn made(folder: &tempfile::TempDir, write: impl FnOnce(&Writer)) -> Artifact {
    let store = Store::open(folder.path()).unwrap();
    let recipe = Recipe::new(Stage::Segment, 1).config(&serde_json::json!({})).unwrap();
    let writer = store.begin(&recipe).unwrap();
    write(&writer);
    writer.publish(ArtifactSummary::default()).unwrap()
}

#[test]
fn every_type_of_cell_is_read_back_unchanged() {
    let folder = tempfile::tempdir().unwrap();
    // Enough rows for several buffered batches and several row groups.
    let rows: Vec<Everything> = (0..9000)
        .map(|i| Everything {
            a: i,
            ..everything(i % 3 != 0)
        })
        .collect();
    let artifact = made(&folder, |writer| {
        let mut table = writer.rows_in_groups::<Everything>(5000).unwrap();
        table.extend(rows.iter().cloned()).unwrap();
        assert_eq!(table.rows(), 9000);
        table.finish().unwrap();
    });
    assert_eq!(artifact.read::<Everything>().unwrap(), rows);
    let table = artifact.table(Everything::table()).unwrap();
    let streamed: Result<Vec<Everything>, _> = table.stream().unwrap().collect();
    assert_eq!(streamed.unwrap(), rows);
    assert_eq!(table.read_range::<Everything>(4999..5002).unwrap(), rows[4999..5002]);
    assert_eq!(rows[1].l.unwrap().translation.x.to_bits(), (-0.0_f64).to_bits());
}

#[test]
fn fields_expand_to_columns_with_unit_frame_and_description() {
    let spec = Everything::table();
    let names: Vec<&str> = spec.columns.iter().map(|column| column.name).collect();
    let tail = [
        "finger_0",
        "finger_1",
        "keypoint_0_x",
        "keypoint_0_y",
        "keypoint_1_x",
        "keypoint_1_y",
    ];
    assert_eq!(names[names.len() - 6..], tail);
    let column = |name| spec.column(name).unwrap();
    assert_eq!((column("k_theta").unit, column("k_theta").frame), ("rad", ""));
    assert_eq!(
        (column("l_z").unit, column("l_z").frame, column("l_z").nullable),
        ("m", "world", true)
    );
    assert_eq!(column("l_qw").description, "Pose: quaternion w.");
    assert_eq!(column("m_rx").unit, "output_max");
    assert_eq!(column("j").kind, ColumnKind::Category);
    assert_eq!(
        OldRow::table().description,
        "One row per measurement, described over two lines."
    );
    assert!(std::ptr::eq(NewRow::<f64>::table(), NewRow::<f64>::table()));
    assert_eq!(NewRow::<f64>::table().columns.len(), 7);
}

columns! {
    /// Some columns, in another order.
    pub struct Some {
        /// Action.
        pub m: SixAxis,
        /// Number.
        pub a: u32,
    }
}

#[test]
fn some_columns_are_read_by_name() {
    let folder = tempfile::tempdir().unwrap();
    let artifact = made(&folder, |writer| {
        writer.write_rows([everything(true)]).unwrap();
    });
    let read: Vec<Some> = artifact.table(Everything::table()).unwrap().read().unwrap();
    assert_eq!((read[0].a, read[0].m.0[5]), (1, 6.0));
    let error = artifact
        .table(Everything::table())
        .unwrap()
        .read::<OldRow>()
        .unwrap_err();
    assert!(error.to_string().contains("episode"), "{error}");
}

#[test]
fn tables_and_columns_of_older_versions_are_read_under_their_former_names() {
    let folder = tempfile::tempdir().unwrap();
    let row = |word: &'static str| OldRow {
        episode: 3,
        word: word.into(),
        place: Some(Vector3::new(1.0, 2.0, 3.0)),
    };
    let artifact = made(&folder, |writer| {
        writer.write_rows([row("transit"), row("transfer")]).unwrap();
    });
    assert!(artifact.has::<NewRow<f64>>());
    let rows: Vec<NewRow<f64>> = artifact.read().unwrap();
    assert_eq!(
        rows[1],
        NewRow {
            id: Identity {
                episode: 3,
                frame: None
            },
            mode: Mode::Transfer,
            object: Some(Vector3::new(1.0, 2.0, 3.0)),
            more: None,
        }
    );
    drop(folder);
    let folder = tempfile::tempdir().unwrap();
    let artifact = made(&folder, |writer| {
        writer.write_rows([row("push")]).unwrap();
    });
    let error = artifact.read::<NewRow<f64>>().unwrap_err();
    assert!(
        matches!(&error, ArtifactError::UnknownWord { word, .. } if word == "push"),
        "{error}"
    );
}

table! {
    /// The same table in another domain.
    #[table("measurements", version = 1)]
    #[domain = "space"]
    pub struct OfSpace {
        /// Demonstration.
        pub episode: u32,
    }
}

table! {
    /// The same table in the domain of its pose, `plane`.
    #[table("measurements", version = 1)]
    pub struct OfPlane {
        /// Where it was.
        pub place: Option<Pose2>,
    }
}

table! {
    /// A part of the older table that is now a separate table.
    #[table("details", version = 2, formerly = "measurements")]
    pub struct DetailOfPlane {
        /// Where it was.
        pub place: Option<Pose2>,
    }
}

#[test]
fn a_planar_table_is_read_under_its_former_name() {
    let folder = tempfile::tempdir().unwrap();
    let place = Some(Pose2::new(1.0, 2.0, 0.5));
    let artifact = made(&folder, |writer| {
        writer.write_rows([OfPlane { place }]).unwrap();
    });
    assert_eq!(artifact.read::<DetailOfPlane>().unwrap(), [DetailOfPlane { place }]);
}

#[test]
fn a_table_of_another_domain_is_refused() {
    let folder = tempfile::tempdir().unwrap();
    let artifact = made(&folder, |writer| {
        writer.write_rows([OfSpace { episode: 0 }]).unwrap();
    });
    let error = artifact.read::<OfPlane>().unwrap_err();
    assert!(
        matches!(&error, ArtifactError::OtherDomain { found, .. } if found == "space"),
        "{error}"
    );
}

#[test]
fn a_word_type_lists_its_words() {
    assert_eq!(Mode::ALL.map(Word::word), ["transit", "transfer"]);
}
