//! What the elements of a vector measure or command, by their names.

use crate::tables::SignalRole;

/// Words in names of grippers.
const GRIPPER: [&str; 6] = ["gripper", "grippers", "finger", "fingers", "claw", "jaw"];

/// Words in names of joints.
const JOINT: [&str; 12] = [
    "joint", "joints", "motor", "shoulder", "elbow", "wrist", "waist", "forearm", "pan", "lift", "flex", "qpos",
];

/// Words in names of the end effector. A name with one of them and a word of [`POSITION`] is a coordinate of its position.
const EEF: [&str; 6] = ["eef", "ee", "tcp", "cartesian", "hand", "effector"];

const POSITION: [&str; 4] = ["pos", "position", "xyz", "translation"];

/// Words in names of numbers of an orientation.
const ORIENTATION: [&str; 31] = [
    "quat",
    "quaternion",
    "ori",
    "orientation",
    "rot",
    "rotation",
    "axis",
    "angle",
    "aa",
    "rotvec",
    "rpy",
    "euler",
    "roll",
    "pitch",
    "yaw",
    "rx",
    "ry",
    "rz",
    "rw",
    "qx",
    "qy",
    "qz",
    "qw",
    "drx",
    "dry",
    "drz",
    "droll",
    "dpitch",
    "dyaw",
    "rot6d",
    "rotmat",
];

/// The words of a name, in lower case: `robot0_eef_pos_2` and `eefPos.2` have `eef` and `pos`.
pub(super) fn words(name: &str) -> Vec<String> {
    let mut words: Vec<String> = Vec::new();
    let mut previous = None;
    for c in name.chars() {
        if c.is_alphanumeric() {
            let boundary = previous.is_none_or(|p: char| !p.is_alphanumeric() || p.is_lowercase() && c.is_uppercase());
            if boundary {
                words.push(String::new());
            }
            if let Some(word) = words.last_mut() {
                word.extend(c.to_lowercase());
            }
        }
        previous = Some(c);
    }
    // The number after a word counts elements: axis_angle1, gripper2. Words such as rot6d keep theirs.
    for word in &mut words {
        let stem = word.trim_end_matches(|c: char| c.is_ascii_digit());
        if !stem.is_empty() {
            word.truncate(stem.len());
        }
    }
    words
}

/// The role of one element by its name. Coordinates with only a letter as name are decided by [`roles`].
fn role(words: &[String]) -> SignalRole {
    let has = |list: &[&str]| words.iter().any(|word| list.contains(&word.as_str()));
    if has(&GRIPPER) {
        SignalRole::Gripper
    } else if has(&EEF) && has(&POSITION) {
        SignalRole::EefPosition
    } else if has(&JOINT) {
        SignalRole::Joint
    } else if has(&ORIENTATION) {
        SignalRole::EefOrientation
    } else {
        SignalRole::Other
    }
}

/// Roles of all elements of a vector by their names. Elements x, y and z that occur once each are the position of the end effector, and
/// dx, dy and dz are its displacement.
pub(super) fn roles(names: &[String]) -> Vec<SignalRole> {
    let words: Vec<Vec<String>> = names.iter().map(|name| words(name)).collect();
    let mut roles: Vec<SignalRole> = words.iter().map(|words| role(words)).collect();
    if roles.contains(&SignalRole::EefPosition) {
        return roles;
    }
    let axis = |letter: &str| {
        let displacement = format!("d{letter}");
        let of_axis = |words: &&Vec<String>| {
            let mut words = words.iter().rev().filter(|word| !EEF.contains(&word.as_str()));
            words.next().is_some_and(|word| word == letter || *word == displacement)
        };
        let found: Vec<usize> = words
            .iter()
            .enumerate()
            .filter(|(place, words)| of_axis(words) && roles[*place] == SignalRole::Other)
            .map(|(place, _)| place)
            .collect();
        <[usize; 1]>::try_from(found).ok().map(|[only]| only)
    };
    if let (Some(x), Some(y), Some(z)) = (axis("x"), axis("y"), axis("z")) {
        for place in [x, y, z] {
            roles[place] = SignalRole::EefPosition;
        }
    }
    roles
}

/// How four numbers of an orientation form a quaternion (x, y, z, w), or three a rotation vector, by their names. `None` if the names
/// do not say it.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub(super) enum Orientation {
    /// A quaternion; the places of x, y, z and w among the four.
    Quaternion([usize; 4]),
    /// A rotation vector.
    Vector,
}

impl Orientation {
    /// Reads the names of the elements of an orientation.
    pub(super) fn of(names: &[String]) -> Option<Self> {
        let words: Vec<Vec<String>> = names.iter().map(|name| words(name)).collect();
        let all = |list: &[&str]| {
            words
                .iter()
                .all(|words| words.iter().any(|word| list.contains(&word.as_str())))
        };
        match names.len() {
            4 => {
                let place = |letter: char| {
                    words
                        .iter()
                        .position(|words| words.last().is_some_and(|word| word.ends_with(letter)))
                };
                let letters = [place('x'), place('y'), place('z'), place('w')];
                match letters {
                    [Some(x), Some(y), Some(z), Some(w)] => Some(Self::Quaternion([x, y, z, w])),
                    // Numbered elements, in the order of robosuite, scipy and ROS.
                    _ if all(&["quat", "quaternion"]) => Some(Self::Quaternion([0, 1, 2, 3])),
                    _ => None,
                }
            }
            3 if all(&["axis", "aa", "rotvec"]) => Some(Self::Vector),
            _ => None,
        }
    }
}

/// The arm that an element belongs to, by a word at the beginning of its name; `None` if the name does not say it.
pub(super) fn arm_of(name: &str) -> Option<String> {
    let lower = name.to_lowercase();
    let first = |text: &str| {
        text.split(|c: char| !c.is_alphanumeric())
            .find(|word| !word.is_empty())
            .map(str::to_owned)
    };
    let start = first(&lower)?;
    let arm = |word: &str| {
        matches!(word, "left" | "right")
            || word
                .strip_prefix("robot")
                .is_some_and(|number| !number.is_empty() && number.bytes().all(|b| b.is_ascii_digit()))
    };
    arm(&start).then_some(start)
}

#[cfg(test)]
mod tests {
    use super::*;

    fn of(names: &[&str]) -> String {
        let names: Vec<String> = names.iter().map(|name| (*name).to_owned()).collect();
        let letter = |role| match role {
            SignalRole::Joint => 'j',
            SignalRole::EefPosition => 'p',
            SignalRole::EefOrientation => 'o',
            SignalRole::Gripper => 'g',
            SignalRole::Other => '-',
        };
        roles(&names).into_iter().map(letter).collect()
    }

    #[test]
    fn names_of_known_datasets_have_roles() {
        let robomimic = [
            "robot0_eef_pos_0",
            "robot0_eef_pos_1",
            "robot0_eef_pos_2",
            "robot0_eef_quat_0",
            "robot0_eef_quat_1",
            "robot0_eef_quat_2",
            "robot0_eef_quat_3",
            "robot0_gripper_qpos_0",
            "robot0_gripper_qpos_1",
        ];
        assert_eq!(of(&robomimic), "pppoooogg");
        let so100 = [
            "main_shoulder_pan",
            "main_shoulder_lift",
            "main_elbow_flex",
            "main_wrist_flex",
            "main_wrist_roll",
            "main_gripper",
        ];
        assert_eq!(of(&so100), "jjjjjg");
        assert_eq!(of(&["shoulder_pan.pos", "wrist_roll.pos", "gripper.pos"]), "jjg");
        assert_eq!(
            of(&["x", "y", "z", "roll", "pitch", "yaw", "gripper", "gripper"]),
            "pppooogg"
        );
        assert_eq!(of(&["x", "y", "z", "rx", "ry", "rz", "rw", "gripper"]), "pppoooog");
        assert_eq!(
            of(&["x", "y", "z", "axis_angle1", "axis_angle2", "axis_angle3", "gripper"]),
            "pppooog"
        );
        assert_eq!(of(&["delta_x", "delta_y", "delta_z", "leftJaw"]), "pppg");
        assert_eq!(of(&["dx", "dy", "dz", "drx", "dry", "drz", "gripper"]), "pppooog");
        assert_eq!(of(&["delta_x_ee", "delta_y_ee", "delta_z_ee", "gripper_delta"]), "pppg");
        assert_eq!(of(&["motor_0", "motor_1"]), "jj");
        assert_eq!(of(&["action_0", "x", "y"]), "---");
        assert_eq!(of(&["left_finger_joint", "panda_joint1"]), "gj");
    }

    #[test]
    fn orientations_are_used_if_their_names_say_how() {
        let of = |names: &[&str]| Orientation::of(&names.iter().map(|name| (*name).to_owned()).collect::<Vec<_>>());
        assert_eq!(
            of(&["qw", "qx", "qy", "qz"]),
            Some(Orientation::Quaternion([1, 2, 3, 0]))
        );
        assert_eq!(
            of(&["quat_0", "quat_1", "quat_2", "quat_3"]),
            Some(Orientation::Quaternion([0, 1, 2, 3]))
        );
        assert_eq!(
            of(&["axis_angle1", "axis_angle2", "axis_angle3"]),
            Some(Orientation::Vector)
        );
        assert_eq!(of(&["roll", "pitch", "yaw"]), None);
        assert_eq!(of(&["a", "b", "c", "d"]), None);
    }

    #[test]
    fn arms_are_told_apart() {
        assert_eq!(arm_of("left_waist").as_deref(), Some("left"));
        assert_eq!(arm_of("robot1_eef_pos_0").as_deref(), Some("robot1"));
        assert_eq!(arm_of("main_gripper"), None);
        assert_eq!(arm_of("leftover"), None);
    }
}
