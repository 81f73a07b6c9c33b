//! Fixed cameras of `MuJoCo` models, to show poses in their images.

use nalgebra::{Isometry3, Point3, Quaternion, Translation3, UnitQuaternion};
use roxmltree::{Document, Node};

/// `MuJoCo`'s field of view if a camera has none, in degrees.
const DEFAULT_FIELD_OF_VIEW: f64 = 45.0;

/// Attributes of a camera that this module does not evaluate. A camera that has one is not projected with.
const OTHER_ATTRIBUTES: [&str; 9] = [
    "euler",
    "axisangle",
    "xyaxes",
    "zaxis",
    "target",
    "focal",
    "focalpixel",
    "sensorsize",
    "class",
];

/// A camera at a fixed pose in the world, with a symmetric perspective projection.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct FixedCamera {
    /// Pose of the camera, world frame, in metres: it looks along -z, +x is to the right and +y is up in the image.
    world_from_camera: Isometry3<f64>,
    /// Half of the image height at a distance of one metre: the tangent of half the vertical field of view.
    half: f64,
}

impl FixedCamera {
    /// The camera of this name in a model. `None` if the model has no such camera in the world body, if the camera moves, or if
    /// its orientation or projection is given in another way than by `quat` and `fovy`.
    #[must_use]
    pub fn find(mjcf: &str, name: &str) -> Option<Self> {
        let document = Document::parse(mjcf).ok()?;
        let root = document.root_element();
        let has_defaults =
            children(root, "default").any(|all| all.descendants().any(|node| node.has_tag_name("camera")));
        let camera = children(root, "worldbody")
            .flat_map(|world| children(world, "camera"))
            .find(|camera| camera.attribute("name") == Some(name))?;
        let moves = !matches!(camera.attribute("mode"), None | Some("fixed"));
        if has_defaults
            || moves
            || OTHER_ATTRIBUTES
                .iter()
                .any(|attribute| camera.has_attribute(*attribute))
        {
            return None;
        }
        let [x, y, z] = numbers(camera.attribute("pos"), [0.0; 3])?;
        let [w, i, j, k] = numbers(camera.attribute("quat"), [1.0, 0.0, 0.0, 0.0])?;
        let rotation = UnitQuaternion::try_new(Quaternion::new(w, i, j, k), 1e-9)?;
        let [field_of_view] = numbers(camera.attribute("fovy"), [DEFAULT_FIELD_OF_VIEW])?;
        (field_of_view > 0.0 && field_of_view < 180.0).then(|| Self {
            world_from_camera: Isometry3::from_parts(Translation3::new(x, y, z), rotation),
            half: (field_of_view.to_radians() / 2.0).tan(),
        })
    }

    /// Projects a point in the world frame (metres) to a square image with a side of `side` pixels. Returns `[column, row]` in
    /// pixels from the top left corner, so that the centre of the first pixel is at (0.5, 0.5). The result is outside the image
    /// for points that the image does not show. `None` for points that are not in front of the camera.
    #[must_use]
    pub fn pixel(&self, point: &Point3<f64>, side: f64) -> Option<[f64; 2]> {
        let local = self.world_from_camera.inverse_transform_point(point);
        let depth = -local.z;
        if depth.is_nan() || depth <= 0.0 {
            return None;
        }
        let scale = side / (2.0 * self.half * depth);
        Some([0.5 * side + scale * local.x, 0.5 * side - scale * local.y])
    }
}

/// The child elements of this name.
fn children<'a, 'input>(node: Node<'a, 'input>, tag: &'static str) -> impl Iterator<Item = Node<'a, 'input>> {
    node.children().filter(move |child| child.has_tag_name(tag))
}

/// The numbers of an attribute, which must be exactly `N` finite ones.
fn numbers<const N: usize>(attribute: Option<&str>, default: [f64; N]) -> Option<[f64; N]> {
    let Some(text) = attribute else { return Some(default) };
    let values: Vec<f64> = text
        .split_ascii_whitespace()
        .map(str::parse)
        .collect::<Result<_, _>>()
        .ok()?;
    values
        .try_into()
        .ok()
        .filter(|values: &[f64; N]| values.iter().all(|value| value.is_finite()))
}

#[cfg(test)]
mod tests {
    use super::*;

    fn model(camera: &str) -> String {
        format!("<mujoco><worldbody>{camera}<body><camera name='hand' pos='0 0 1'/></body></worldbody></mujoco>")
    }

    /// Two metres above the origin, looking down, with +x to the right.
    const ABOVE: &str = "<camera name='above' pos='0 0 2' fovy='90'/>";

    #[test]
    fn points_are_projected_to_the_side_on_which_they_are() {
        let camera = FixedCamera::find(&model(ABOVE), "above").unwrap();
        let at = |x, y, z| camera.pixel(&Point3::new(x, y, z), 80.0);
        // At a depth of 2 m the image is 4 m high, so a metre has 20 pixels.
        assert_eq!(at(0.0, 0.0, 0.0).map(|pixel| pixel.map(f64::round)), Some([40.0, 40.0]));
        assert_eq!(at(1.0, 0.0, 0.0).map(|pixel| pixel.map(f64::round)), Some([60.0, 40.0]));
        assert_eq!(at(0.0, 1.0, 0.0).map(|pixel| pixel.map(f64::round)), Some([40.0, 20.0]));
        assert_eq!(at(1.0, 0.0, 1.0).map(|pixel| pixel.map(f64::round)), Some([80.0, 40.0]));
        assert_eq!(at(0.0, 0.0, 2.0), None);
        assert_eq!(at(0.0, 0.0, 3.0), None);
        assert_eq!(at(0.0, 0.0, f64::NAN), None);
    }

    #[test]
    fn the_rotation_is_that_of_the_quaternion() {
        // Rotated by 90 degrees about the optical axis: +y of the world is to the left.
        let rotated = "<camera name='above' pos='0 0 2' quat='0.7071067811865476 0 0 0.7071067811865476' fovy='90'/>";
        let camera = FixedCamera::find(&model(rotated), "above").unwrap();
        let pixel = camera.pixel(&Point3::new(1.0, 0.0, 0.0), 80.0);
        assert_eq!(pixel.map(|pixel| pixel.map(f64::round)), Some([40.0, 60.0]));
    }

    #[test]
    fn cameras_that_cannot_be_evaluated_are_not_found() {
        assert!(FixedCamera::find(&model(ABOVE), "other").is_none());
        assert!(FixedCamera::find(&model(ABOVE), "hand").is_none());
        assert!(FixedCamera::find("not a model", "above").is_none());
        for attribute in [
            "mode='trackcom'",
            "euler='0 0 1'",
            "xyaxes='1 0 0 0 1 0'",
            "quat='0 0 0 0'",
            "pos='0 0'",
            "fovy='nan'",
            "fovy='180'",
        ] {
            let camera = format!("<camera name='above' {attribute}/>");
            assert!(FixedCamera::find(&model(&camera), "above").is_none(), "{attribute}");
        }
        let defaults =
            "<mujoco><default><camera fovy='60'/></default><worldbody><camera name='above'/></worldbody></mujoco>";
        assert!(FixedCamera::find(defaults, "above").is_none());
    }
}
