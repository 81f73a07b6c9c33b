//! Offsets of the fields of MuJoCo's structures that this crate reads and writes.
//!
//! Offsets are in bytes, from the headers in MuJoCo's wheels for 64-bit Linux. If the headers are available, `tests/layout.rs`
//! compiles them and compares the offsets.

use std::fmt;

/// A supported version of MuJoCo.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Hash, PartialOrd, Ord)]
pub enum Version {
    /// 2.3.7, which robosuite 1.4.1 uses.
    V2_3_7,
    /// 3.2.7, which robosuite 1.5.1 uses.
    V3_2_7,
}

impl Version {
    /// All supported versions.
    pub const ALL: [Self; 2] = [Self::V2_3_7, Self::V3_2_7];

    /// The number that `mj_version` returns.
    pub(crate) fn number(self) -> i32 {
        match self {
            Self::V2_3_7 => 237,
            Self::V3_2_7 => 327,
        }
    }

    pub(crate) fn layout(self) -> &'static Layout {
        match self {
            Self::V2_3_7 => &LAYOUT_2_3_7,
            Self::V3_2_7 => &LAYOUT_3_2_7,
        }
    }

    /// All offsets with the names of their fields, for tests that compare them with the headers. A name is a C expression in
    /// `mjModel` (`m`), `mjData` (`d`), `mjvOption` (`option`), `mjvCamera` (`camera`), `mjvScene` (`scene`), `mjvGeom` (`geom`),
    /// `mjvGLCamera` (`eye`) or `mjrContext` (`context`).
    #[must_use]
    pub fn offsets(self) -> Vec<(&'static str, usize)> {
        self.layout().named()
    }

    /// Sizes (bytes) of structures with their names, for tests that compare them with the headers.
    #[must_use]
    pub fn sizes(self) -> Vec<(&'static str, usize)> {
        self.layout().sizes.named()
    }
}

impl fmt::Display for Version {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        f.write_str(match self {
            Self::V2_3_7 => "2.3.7",
            Self::V3_2_7 => "3.2.7",
        })
    }
}

macro_rules! layout {
    ($($(#[$doc:meta])* $field:ident = $name:literal),* $(,)?) => {
        /// Offsets of fields.
        pub(crate) struct Layout {
            $($(#[$doc])* pub(crate) $field: usize,)*
            /// Sizes of structures.
            pub(crate) sizes: Sizes,
        }

        impl Layout {
            fn named(&self) -> Vec<(&'static str, usize)> {
                vec![$(($name, self.$field)),*]
            }
        }
    };
}

/// Sizes of structures, in bytes.
pub(crate) struct Sizes {
    pub(crate) option: usize,
    pub(crate) camera: usize,
    pub(crate) perturb: usize,
    pub(crate) scene: usize,
    pub(crate) geom: usize,
    pub(crate) eye: usize,
    pub(crate) context: usize,
    pub(crate) model: usize,
}

impl Sizes {
    fn named(&self) -> Vec<(&'static str, usize)> {
        vec![
            ("mjvOption", self.option),
            ("mjvCamera", self.camera),
            ("mjvPerturb", self.perturb),
            ("mjvScene", self.scene),
            ("mjvGeom", self.geom),
            ("mjvGLCamera", self.eye),
            ("mjrContext", self.context),
            ("mjModel", self.model),
        ]
    }
}

layout! {
    /// Number of generalised coordinates.
    nq = "m.nq",
    /// Number of degrees of freedom.
    nv = "m.nv",
    /// Number of actuators.
    nu = "m.nu",
    /// Number of activation states.
    na = "m.na",
    /// Number of bodies.
    nbody = "m.nbody",
    /// Number of joints.
    njnt = "m.njnt",
    /// Number of sites.
    nsite = "m.nsite",
    /// Time step, in seconds.
    timestep = "m.opt.timestep",
    /// Types of joints.
    jnt_type = "m.jnt_type",
    /// First coordinates of joints.
    jnt_qposadr = "m.jnt_qposadr",
    /// First degrees of freedom of joints.
    jnt_dofadr = "m.jnt_dofadr",
    /// Minimum and maximum controls of actuators.
    actuator_ctrlrange = "m.actuator_ctrlrange",
    /// Simulated time.
    time = "d.time",
    /// Coordinates.
    qpos = "d.qpos",
    /// Velocities.
    qvel = "d.qvel",
    /// Controls.
    ctrl = "d.ctrl",
    /// Accelerations from which the solver starts.
    qacc_warmstart = "d.qacc_warmstart",
    /// Gravity, Coriolis and centrifugal forces.
    qfrc_bias = "d.qfrc_bias",
    /// Packed inertia matrix.
    q_m = "d.qM",
    /// World positions of sites.
    site_xpos = "d.site_xpos",
    /// World rotation matrices of sites.
    site_xmat = "d.site_xmat",
    /// World positions of bodies.
    xpos = "d.xpos",
    /// World orientations (quaternions) of bodies.
    xquat = "d.xquat",
    /// Statistics of warnings.
    warning = "d.warning",
    /// Flags for the groups of geoms that are rendered.
    geomgroup = "option.geomgroup",
    /// Flags for the groups of sites that are rendered.
    sitegroup = "option.sitegroup",
    /// Type of a camera.
    camera_type = "camera.type",
    /// Index of the model's camera that is used.
    fixedcamid = "camera.fixedcamid",
    /// Number of geoms in a scene.
    scene_ngeom = "scene.ngeom",
    /// Geoms of a scene.
    scene_geoms = "scene.geoms",
    /// The two cameras (eyes) of a scene.
    scene_camera = "scene.camera",
    /// Width of the off-screen buffer.
    context_width = "context.offWidth",
    /// The buffer that is rendered to.
    context_buffer = "context.currentBuffer",
    /// Number of cameras.
    ncam = "m.ncam",
    /// Rendering flags.
    scene_flags = "scene.flags",
    /// Type of a geom.
    geom_type = "geom.type",
    /// Type of the model's element that a geom shows.
    geom_objtype = "geom.objtype",
    /// Index of the model's element that a geom shows.
    geom_objid = "geom.objid",
    /// Size of a geom.
    geom_size = "geom.size",
    /// Position of a geom.
    geom_pos = "geom.pos",
    /// Rotation matrix of a geom.
    geom_mat = "geom.mat",
    /// Colour of a geom.
    geom_rgba = "geom.rgba",
    /// Reflectance of a geom.
    geom_reflectance = "geom.reflectance",
    /// Position of an eye.
    eye_pos = "eye.pos",
    /// Viewing direction of an eye.
    eye_forward = "eye.forward",
    /// Upward direction of an eye.
    eye_up = "eye.up",
    /// Horizontal centre of an eye's frustum at the near plane.
    eye_center = "eye.frustum_center",
    /// Lower edge of an eye's frustum at the near plane.
    eye_bottom = "eye.frustum_bottom",
    /// Upper edge of an eye's frustum at the near plane.
    eye_top = "eye.frustum_top",
    /// Depth of the near plane.
    eye_near = "eye.frustum_near",
    /// Number of geoms.
    ngeom = "m.ngeom",
    /// Bounding boxes of geoms.
    geom_aabb = "m.geom_aabb",
    /// Types of geoms.
    model_geom_type = "m.geom_type",
    /// Sizes of geoms.
    model_geom_size = "m.geom_size",
    /// Radii of bounding spheres of geoms.
    model_geom_rbound = "m.geom_rbound",
    /// Number of lights.
    nlight = "m.nlight",
    /// Whether a light casts shadows.
    light_castshadow = "m.light_castshadow",
    /// Number of meshes.
    nmesh = "m.nmesh",
    /// Number of triangles of all meshes.
    nmeshface = "m.nmeshface",
    /// Number of textures.
    ntex = "m.ntex",
    /// Types of textures.
    tex_type = "m.tex_type",
    /// Numbers of rows of textures.
    tex_height = "m.tex_height",
    /// Numbers of columns of textures.
    tex_width = "m.tex_width",
    /// Side length of the shadow map, in pixels.
    shadowsize = "m.vis.quality.shadowsize",
    /// Number of samples per pixel.
    offsamples = "m.vis.quality.offsamples",
    /// Width of the off-screen buffer.
    offwidth = "m.vis.global.offwidth",
    /// Height of the off-screen buffer.
    offheight = "m.vis.global.offheight",
    /// OpenGL names of the uploaded textures.
    context_texture = "context.texture",
    /// First display list of planes. This field follows the names of textures.
    context_base_plane = "context.basePlane",
    /// First display list of meshes.
    context_base_mesh = "context.baseMesh",
    /// Number of display lists of meshes.
    context_range_mesh = "context.rangeMesh",
}

static LAYOUT_2_3_7: Layout = Layout {
    nq: 0,
    nv: 4,
    nu: 8,
    na: 12,
    nbody: 16,
    njnt: 24,
    nsite: 32,
    timestep: 264,
    jnt_type: 1384,
    jnt_qposadr: 1392,
    jnt_dofadr: 1400,
    actuator_ctrlrange: 3000,
    time: 40392,
    qpos: 40432,
    qvel: 40440,
    ctrl: 40472,
    qacc_warmstart: 40456,
    qfrc_bias: 40872,
    q_m: 40800,
    site_xpos: 40632,
    site_xmat: 40640,
    xpos: 40560,
    xquat: 40568,
    warning: 56,
    geomgroup: 8,
    sitegroup: 14,
    camera_type: 0,
    fixedcamid: 4,
    scene_ngeom: 4,
    scene_geoms: 8,
    scene_camera: 8476,
    context_width: 40,
    context_buffer: 2300,
    ncam: 36,
    scene_flags: 8628,
    geom_type: 0,
    geom_objtype: 8,
    geom_objid: 12,
    geom_size: 44,
    geom_pos: 56,
    geom_mat: 68,
    geom_rgba: 104,
    geom_reflectance: 132,
    eye_pos: 0,
    eye_forward: 12,
    eye_up: 24,
    eye_center: 36,
    eye_bottom: 40,
    eye_top: 44,
    eye_near: 48,
    ngeom: 28,
    geom_aabb: 1720,
    model_geom_type: 1_608,
    model_geom_size: 1_712,
    model_geom_rbound: 1_728,
    nlight: 40,
    light_castshadow: 2000,
    nmesh: 44,
    nmeshface: 60,
    ntex: 100,
    tex_type: 2456,
    tex_height: 2464,
    tex_width: 2472,
    shadowsize: 544,
    offsamples: 548,
    offwidth: 532,
    offheight: 536,
    context_texture: 772,
    context_base_plane: 1172,
    context_base_mesh: 1176,
    context_range_mesh: 1204,
    sizes: Sizes {
        option: 76,
        camera: 64,
        perturb: 136,
        scene: 8_656,
        geom: 248,
        eye: 56,
        context: 2_312,
        model: 3_560,
    },
};

static LAYOUT_3_2_7: Layout = Layout {
    nq: 0,
    nv: 4,
    nu: 8,
    na: 12,
    nbody: 16,
    njnt: 32,
    nsite: 40,
    timestep: 336,
    jnt_type: 1616,
    jnt_qposadr: 1624,
    jnt_dofadr: 1632,
    actuator_ctrlrange: 3824,
    time: 161_616,
    qpos: 161_656,
    qvel: 161_664,
    ctrl: 161_696,
    qacc_warmstart: 161_680,
    qfrc_bias: 162_192,
    q_m: 162_112,
    site_xpos: 161_864,
    site_xmat: 161_872,
    xpos: 161_792,
    xquat: 161_800,
    warning: 161_280,
    geomgroup: 8,
    sitegroup: 14,
    camera_type: 0,
    fixedcamid: 4,
    scene_ngeom: 4,
    scene_geoms: 8,
    scene_camera: 8980,
    context_width: 40,
    context_buffer: 61_500,
    ncam: 44,
    scene_flags: 9148,
    geom_type: 0,
    geom_objtype: 8,
    geom_objid: 12,
    geom_size: 32,
    geom_pos: 44,
    geom_mat: 56,
    geom_rgba: 92,
    geom_reflectance: 120,
    eye_pos: 0,
    eye_forward: 12,
    eye_up: 24,
    eye_center: 36,
    eye_bottom: 44,
    eye_top: 48,
    eye_near: 52,
    ngeom: 36,
    geom_aabb: 1976,
    model_geom_type: 1_856,
    model_geom_size: 1_968,
    model_geom_rbound: 1_984,
    nlight: 48,
    light_castshadow: 2288,
    nmesh: 88,
    nmeshface: 104,
    ntex: 144,
    tex_type: 3232,
    tex_height: 3240,
    tex_width: 3248,
    shadowsize: 688,
    offsamples: 692,
    offwidth: 672,
    offheight: 676,
    context_texture: 56_372,
    context_base_plane: 60_372,
    context_base_mesh: 60_376,
    context_range_mesh: 60_404,
    sizes: Sizes {
        option: 92,
        camera: 72,
        perturb: 144,
        scene: 9_176,
        geom: 236,
        eye: 64,
        context: 61_512,
        model: 4_400,
    },
};
