//! Parsing of MJCF into a [`Model`].

use std::collections::BTreeMap;

use nalgebra::{Isometry3, Quaternion, Translation3, Unit, UnitQuaternion, Vector3};
use roxmltree::{Document, Node};

use super::{Body, Joint, JointKind, KinematicsError, Model, Site};

/// Maximum nesting depth of bodies and defaults. A robot on a mount has about twenty levels. The limit bounds the
/// recursion of the parser.
const DEEPEST: usize = 200;

/// An error for a model that cannot be used.
fn refuse<T>(sentence: String) -> Result<T, KinematicsError> {
    Err(KinematicsError::Model(sentence))
}

/// Settings of the element `compiler`: the unit of angles and the sequence of Euler angles.
struct Compiler {
    degrees: bool,
    euler: String,
}

impl Compiler {
    fn radians(&self, angle: f64) -> f64 {
        if self.degrees { angle.to_radians() } else { angle }
    }
}

/// Default attributes of a class, by element and attribute, including those of its parents.
type Class<'a> = BTreeMap<&'a str, BTreeMap<&'a str, &'a str>>;

struct Parser<'a> {
    compiler: Compiler,
    classes: BTreeMap<&'a str, Class<'a>>,
    model: Model,
}

pub(super) fn parse(text: &str) -> Result<Model, KinematicsError> {
    let document = Document::parse(text).map_err(|error| KinematicsError::Xml(error.to_string()))?;
    let root = document.root_element();
    if root.tag_name().name() != "mujoco" {
        return refuse(format!(
            "its root element is <{}>, not <mujoco>",
            root.tag_name().name()
        ));
    }
    let mut parser = Parser {
        compiler: compiler(root)?,
        classes: BTreeMap::from([("main", Class::new())]),
        model: Model {
            bodies: vec![Body {
                name: "world".to_owned(),
                parent: 0,
                pose: Isometry3::identity(),
                joints: Vec::new(),
            }],
            sites: Vec::new(),
            positions: 0,
            velocities: 0,
        },
    };
    for element in elements(root, "default") {
        parser.read_class(element, None, 0)?;
    }
    let mut worlds = elements(root, "worldbody").peekable();
    if worlds.peek().is_none() {
        return refuse("it has no <worldbody>".to_owned());
    }
    for world in worlds {
        parser.read_body(world, 0, "main", 0)?;
    }
    Ok(parser.model)
}

/// The child elements with this tag.
fn elements<'a, 'input: 'a>(node: Node<'a, 'input>, name: &'static str) -> impl Iterator<Item = Node<'a, 'input>> {
    node.children().filter(move |child| child.has_tag_name(name))
}

/// Reads the element `compiler`. Without it MJCF's defaults apply: degrees and the sequence `xyz`.
fn compiler(root: Node<'_, '_>) -> Result<Compiler, KinematicsError> {
    let mut result = Compiler {
        degrees: true,
        euler: "xyz".to_owned(),
    };
    for element in elements(root, "compiler") {
        match element.attribute("angle") {
            Some("radian") => result.degrees = false,
            Some("degree") => result.degrees = true,
            Some(other) => return refuse(format!("its compiler has angle=\"{other}\", not radian or degree")),
            None => {}
        }
        if let Some(sequence) = element.attribute("eulerseq") {
            if sequence.len() != 3 || !sequence.chars().all(|axis| "xyzXYZ".contains(axis)) {
                return refuse(format!("its compiler has eulerseq=\"{sequence}\", not three axes"));
            }
            sequence.clone_into(&mut result.euler);
        }
        if element.attribute("coordinate") == Some("global") {
            return refuse("it uses global coordinates, which MuJoCo no longer supports".to_owned());
        }
    }
    Ok(result)
}

/// The numbers of an attribute. Some attributes in models of robosuite 1.0 are Python lists, so brackets and commas count as
/// spaces.
fn numbers<const N: usize>(element: &str, attribute: &str, text: &str) -> Result<[f64; N], KinematicsError> {
    let mut result = [0.0; N];
    let mut words = text
        .split([' ', '\t', '\n', '\r', ',', '[', ']'])
        .filter(|word| !word.is_empty());
    for value in &mut result {
        match words.next().and_then(|word| word.parse::<f64>().ok()) {
            Some(number) if number.is_finite() => *value = number,
            _ => return refuse(format!("{element} has {attribute}=\"{text}\", not {N} finite numbers")),
        }
    }
    match words.next() {
        None => Ok(result),
        Some(_) => refuse(format!("{element} has {attribute}=\"{text}\", not {N} finite numbers")),
    }
}

/// Describes an element in error messages by its tag and name.
fn called(node: Node<'_, '_>) -> String {
    match node.attribute("name") {
        Some(name) => format!("<{}> {name}", node.tag_name().name()),
        None => format!("an unnamed <{}>", node.tag_name().name()),
    }
}

impl<'a> Parser<'a> {
    /// Reads an element `default` and those nested in it.
    fn read_class(
        &mut self,
        node: Node<'a, 'a>,
        parent: Option<&Class<'a>>,
        depth: usize,
    ) -> Result<(), KinematicsError> {
        if depth > DEEPEST {
            return refuse(format!("its defaults are nested more than {DEEPEST} levels deep"));
        }
        let name = match (node.attribute("class"), depth) {
            (Some(name), _) => name,
            (None, 0) => "main",
            (None, _) => return refuse("a nested <default> has no class".to_owned()),
        };
        let mut class = parent.cloned().unwrap_or_default();
        for child in node
            .children()
            .filter(|child| child.is_element() && !child.has_tag_name("default"))
        {
            let attributes = class.entry(child.tag_name().name()).or_default();
            attributes.extend(child.attributes().map(|a| (a.name(), a.value())));
        }
        // The outermost class applies to all elements without a class, whatever its name.
        if depth == 0 {
            self.classes.insert("main", class.clone());
        }
        for child in elements(node, "default") {
            self.read_class(child, Some(&class), depth + 1)?;
        }
        self.classes.insert(name, class);
        Ok(())
    }

    /// The value of an element's attribute, or the default of its class.
    fn attribute(&self, node: Node<'a, 'a>, class: &str, attribute: &str) -> Result<Option<&'a str>, KinematicsError> {
        if let Some(value) = node.attribute(attribute) {
            return Ok(Some(value));
        }
        let class = node.attribute("class").unwrap_or(class);
        let Some(defaults) = self.classes.get(class) else {
            return refuse(format!(
                "{} has the class {class}, which no <default> defines",
                called(node)
            ));
        };
        let of_element = defaults.get(node.tag_name().name());
        Ok(of_element.and_then(|attributes| attributes.get(attribute).copied()))
    }

    /// The vector in an element's attribute, or a default.
    fn vector(
        &self,
        node: Node<'a, 'a>,
        class: &str,
        attribute: &str,
        default: [f64; 3],
    ) -> Result<Vector3<f64>, KinematicsError> {
        let text = self.attribute(node, class, attribute)?;
        let numbers = text.map_or(Ok(default), |text| numbers(&called(node), attribute, text))?;
        Ok(Vector3::from(numbers))
    }

    /// The pose that an element's attributes `pos` and one of `quat`, `axisangle` and `euler` give.
    fn pose(&self, node: Node<'a, 'a>, class: &str) -> Result<Isometry3<f64>, KinematicsError> {
        let position = self.vector(node, class, "pos", [0.0; 3])?;
        for unknown in ["xyaxes", "zaxis", "fromto"] {
            if self.attribute(node, class, unknown)?.is_some() {
                return refuse(format!(
                    "{} has the attribute {unknown}, which is not supported: use quat",
                    called(node)
                ));
            }
        }
        let rotation = if let Some(text) = self.attribute(node, class, "axisangle")? {
            let [x, y, z, angle] = numbers(&called(node), "axisangle", text)?;
            let axis = unit(node, "axisangle", Vector3::new(x, y, z))?;
            UnitQuaternion::from_axis_angle(&axis, self.compiler.radians(angle))
        } else if let Some(text) = self.attribute(node, class, "euler")? {
            self.euler(numbers(&called(node), "euler", text)?)
        } else if let Some(text) = self.attribute(node, class, "quat")? {
            let [w, x, y, z] = numbers(&called(node), "quat", text)?;
            match UnitQuaternion::try_new(Quaternion::new(w, x, y, z), 1e-12) {
                Some(rotation) => rotation,
                None => return refuse(format!("{} has quat=\"{text}\", which is zero", called(node))),
            }
        } else {
            UnitQuaternion::identity()
        };
        Ok(Isometry3::from_parts(Translation3::from(position), rotation))
    }

    /// Converts Euler angles. Lower-case letters of the sequence are rotations about the rotated axes, capitals about the fixed
    /// axes.
    fn euler(&self, angles: [f64; 3]) -> UnitQuaternion<f64> {
        let mut result = UnitQuaternion::identity();
        for (axis, angle) in self.compiler.euler.chars().zip(angles) {
            let unit = match axis.to_ascii_lowercase() {
                'x' => Vector3::x_axis(),
                'y' => Vector3::y_axis(),
                _ => Vector3::z_axis(),
            };
            let rotation = UnitQuaternion::from_axis_angle(&unit, self.compiler.radians(angle));
            result = if axis.is_lowercase() {
                result * rotation
            } else {
                rotation * result
            };
        }
        result
    }

    /// Reads the joints and sites of a body, then its children. `qpos` has the joints in this depth-first order.
    fn read_body(
        &mut self,
        node: Node<'a, 'a>,
        body: usize,
        class: &'a str,
        depth: usize,
    ) -> Result<(), KinematicsError> {
        if depth > DEEPEST {
            return refuse(format!("its bodies are nested more than {DEEPEST} levels deep"));
        }
        for child in node.children().filter(Node::is_element) {
            match child.tag_name().name() {
                "joint" | "freejoint" => self.read_joint(child, body, class)?,
                "site" => {
                    let pose = self.pose(child, class)?;
                    let name = child.attribute("name").unwrap_or_default().to_owned();
                    self.model.sites.push(Site { name, body, pose });
                }
                // These elements add bodies or joints that this parser would miss.
                unknown @ ("frame" | "replicate" | "attach" | "include" | "composite" | "flexcomp") => {
                    return refuse(format!(
                        "{} contains <{unknown}>, which is not supported: save the compiled model",
                        called(node)
                    ));
                }
                _ => {}
            }
        }
        for child in elements(node, "body") {
            // Bodies have no defaults, so the class does not matter.
            let pose = self.pose(child, "main")?;
            let index = self.model.bodies.len();
            self.model.bodies.push(Body {
                name: child.attribute("name").unwrap_or_default().to_owned(),
                parent: body,
                pose,
                joints: Vec::new(),
            });
            let class = child.attribute("childclass").unwrap_or(class);
            self.read_body(child, index, class, depth + 1)?;
        }
        Ok(())
    }

    /// Adds a joint to a body.
    fn read_joint(&mut self, node: Node<'a, 'a>, body: usize, class: &str) -> Result<(), KinematicsError> {
        let kind = if node.has_tag_name("freejoint") {
            JointKind::Free
        } else {
            match self.attribute(node, class, "type")?.unwrap_or("hinge") {
                "free" => JointKind::Free,
                "ball" => JointKind::Ball,
                "slide" => JointKind::Slide,
                "hinge" => JointKind::Hinge,
                other => {
                    return refuse(format!(
                        "{} has type=\"{other}\", not free, ball, slide or hinge",
                        called(node)
                    ));
                }
            }
        };
        if body == 0 {
            return refuse(format!("{} is a joint of the world body", called(node)));
        }
        if kind == JointKind::Free
            && (self.model.bodies[body].parent != 0 || !self.model.bodies[body].joints.is_empty())
        {
            return refuse(format!(
                "{} is a free joint, but not the only joint of a child of the world body",
                called(node)
            ));
        }
        let axis = self.vector(node, class, "axis", [0.0, 0.0, 1.0])?;
        let reference = match self.attribute(node, class, "ref")? {
            Some(text) => numbers::<1>(&called(node), "ref", text)?[0],
            None => 0.0,
        };
        let joint = Joint {
            name: node.attribute("name").unwrap_or_default().to_owned(),
            kind,
            address: self.model.positions,
            position: self.vector(node, class, "pos", [0.0; 3])?,
            axis: unit(node, "axis", axis)?,
            reference: if kind == JointKind::Hinge {
                self.compiler.radians(reference)
            } else {
                reference
            },
        };
        self.model.positions += kind.positions();
        self.model.velocities += kind.velocities();
        self.model.bodies[body].joints.push(joint);
        Ok(())
    }
}

/// Normalises the vector of an attribute.
fn unit(node: Node<'_, '_>, attribute: &str, vector: Vector3<f64>) -> Result<Unit<Vector3<f64>>, KinematicsError> {
    match Unit::try_new(vector, 1e-12) {
        Some(unit) => Ok(unit),
        None => refuse(format!("{} has a zero vector as {attribute}", called(node))),
    }
}
