//! How a file was recorded, for comparing it with other files of one dataset.

use super::fault::Hdf5Fault;
use super::reader::RobomimicReader;
use crate::error::{Fault, IngestError};

/// Entries of the description of a controller.
const CONTROLLER: [&str; 8] = [
    "kind",
    "input_min",
    "input_max",
    "output_min",
    "output_max",
    "input_ref_frame",
    "kp",
    "damping_ratio",
];

impl RobomimicReader {
    /// How the file was recorded, as far as its attributes, its layout and its cameras say: what all files of a dataset must have in
    /// common. `setting` replaces the attribute `env_args`.
    pub(super) fn recorded(&self, setting: Option<&str>) -> Result<Vec<(String, String)>, IngestError> {
        let mut all: Vec<(String, String)> = Vec::new();
        let mut add = |name: &str, value: String| all.push((name.to_owned(), value));
        let or_fault = |fault: Hdf5Fault| Fault::from(fault).of(&self.path);
        match self.environment(setting) {
            Ok(env) => {
                let or_none = |value: Option<String>| value.unwrap_or_else(|| "none".to_owned());
                add("environment", env.env_name);
                add("robosuite version", or_none(env.env_version));
                add("robots", env.robots.join(", "));
                add("control rate", or_none(env.control_freq.map(|rate| rate.to_string())));
                // One entry of the controller after the other, so that the message names the one that differs.
                let controller = serde_json::to_value(env.controller).unwrap_or_default();
                for name in CONTROLLER {
                    add(&format!("controller's {name}"), controller[name].to_string());
                }
            }
            Err(fault @ Hdf5Fault::NeedsLibrary) => return Err(or_fault(fault)),
            // Reported when the conventions are proven, if they need it.
            Err(_) => add("attribute env_args", "unusable".to_owned()),
        }
        let own = self.file.text("data", "env_args").map_err(or_fault)?;
        let own: serde_json::Value = own
            .and_then(|text| serde_json::from_str(&text).ok())
            .unwrap_or_default();
        add("gripper", own["env_kwargs"]["gripper_types"].to_string());
        add("layout", format!("{:?}", self.layout()).to_lowercase());
        add(
            "poses of the object",
            format!("from states: {}", self.surveyed.object_from_states),
        );
        add("images", self.first_images().map_err(or_fault)?);
        Ok(all)
    }

    /// Cameras of the first demonstration with the shapes of their images, as text.
    fn first_images(&self) -> Result<String, Hdf5Fault> {
        self.of_first(|demo| {
            let group = format!("data/{demo}/obs");
            let mut cameras = Vec::new();
            for name in self.file.members_or_none(&group)? {
                if let Some(camera) = self.image_names.camera(&name) {
                    let located = self.file.locate(&format!("{group}/{name}"))?;
                    let shape: Vec<String> = located.shape.iter().skip(1).map(usize::to_string).collect();
                    cameras.push(format!("{camera} {}", shape.join(" x ")));
                }
            }
            Ok(if cameras.is_empty() {
                "none".to_owned()
            } else {
                cameras.join(", ")
            })
        })
    }
}
