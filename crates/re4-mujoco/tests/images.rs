//! Images of a small scene: trimming does not change them, and threads do not affect each other.
#![allow(clippy::unwrap_used, clippy::print_stdout, reason = "tests may panic")]

use std::path::PathBuf;

use re4_mujoco::{Data, Gl, Library, Model, MujocoError, Renderer, Version};

/// A table above a reflecting floor. Above the table there is a body with a free joint, a red box, a collision box (group 0) and a
/// site. One of the two wedges is only visible in the mirror.
const SCENE: &str = r#"<mujoco>
  <asset>
    <material name="mirror" reflectance="0.5" rgba="0.3 0.3 0.3 1"/>
    <mesh name="wedge" vertex="0 0 0  0.3 0 0  0 0.3 0  0 0 0.3"/>
  </asset>
  <worldbody>
    <light pos="0 0 3" castshadow="false"/>
    <geom name="floor" type="plane" size="3 3 0.1" material="mirror" group="1"/>
    <geom name="table" type="box" size="0.4 0.4 0.05" pos="0 0 0.5" group="1" rgba="0.4 0.4 0.4 1"/>
    <geom type="mesh" mesh="wedge" pos="-1 0.8 1.5" rgba="0 1 0 1" group="1"/>
    <geom type="mesh" mesh="wedge" pos="0 -0.8 0.3" rgba="0 0 1 1" group="1"/>
    <body pos="0 0 0.7">
      <freejoint name="free"/>
      <geom name="cube" type="box" size="0.1 0.1 0.1" rgba="1 0 0 1" group="1"/>
      <geom type="box" size="0.3 0.3 0.3" rgba="1 1 1 1"/>
      <site pos="0 0 0.2" size="0.2"/>
    </body>
    <camera name="front" pos="2 0 1.5" xyaxes="0 1 0 -0.5 0 1"/>
    <camera name="above" pos="0 0 1.2" xyaxes="0 1 0 -1 0 0"/>
  </worldbody>
</mujoco>"#;

/// Compiles the scene, if the library and an OpenGL library are available.
fn model(version: Version) -> Option<Model> {
    let beside = PathBuf::from(env!("CARGO_MANIFEST_DIR")).join("../../data/simulators");
    let folder = std::env::var_os("RE4_SIMULATORS").map_or(beside, PathBuf::from);
    if let Err(error) = Gl::of_process() {
        println!("skipped: {error}");
        return None;
    }
    let library = Library::open(&folder.join(format!("mujoco-{version}")), version);
    if let Err(error @ MujocoError::Missing { .. }) = &library {
        println!("skipped: {error}");
        return None;
    }
    Some(Model::compile(&library.unwrap(), SCENE).unwrap())
}

/// The scene with a texture on the table, a sky, and a light that optionally casts shadows.
fn decorated(shadows: bool) -> String {
    SCENE
        .replace(
            "<asset>",
            r#"<asset>
    <texture name="tiles" type="2d" builtin="checker" rgb1="0 0 0" rgb2="0 0 1" width="64" height="64"/>
    <texture name="sky" type="skybox" builtin="flat" rgb1="0 0.3 0" width="32" height="192"/>
    <material name="tiles" texture="tiles" texrepeat="4 4"/>"#,
        )
        .replace(
            r#"pos="0 0 0.5" group="1""#,
            r#"pos="0 0 0.5" group="1" material="tiles""#,
        )
        .replace(
            r#"castshadow="false""#,
            if shadows { "" } else { r#"castshadow="false""# },
        )
}

/// Images of the cube at different heights, from both cameras.
fn images(renderer: &mut Renderer, model: &Model) -> Vec<Vec<u8>> {
    let mut data = Data::new(model).unwrap();
    let mut images = Vec::new();
    for step in 0..6 {
        data.qpos_mut()[2] = 0.6 + 0.1 * f64::from(step);
        data.forward();
        for camera in ["front", "above"] {
            images.push(renderer.render(&mut data, camera).unwrap());
        }
    }
    images
}

fn count(image: &[u8], colour: impl Fn([u8; 3]) -> bool) -> usize {
    let (pixels, _) = image.as_chunks::<3>();
    pixels.iter().filter(|&&pixel| colour(pixel)).count()
}

#[test]
fn images_are_upright_and_show_what_robosuite_shows() {
    for model in Version::ALL.into_iter().filter_map(model) {
        let mut renderer = Renderer::new(&model, 60, 40).unwrap();
        let mut data = Data::new(&model).unwrap();
        data.qpos_mut()[2] = 1.2;
        data.forward();
        let image = renderer.render(&mut data, "front").unwrap();
        assert_eq!(image.len(), 60 * 40 * 3);
        let red = |pixel: [u8; 3]| pixel[0] > 60 && pixel[1] < 30 && pixel[2] < 30;
        let (top, bottom) = image.split_at(60 * 20 * 3);
        assert!(
            count(top, red) > 10 && count(top, red) > count(bottom, red),
            "the cube is in the upper half"
        );
        let white = |pixel: [u8; 3]| pixel.iter().all(|&part| part > 150);
        assert_eq!(count(&image, white), 0, "geoms of group 0 and sites are not shown");
        assert!(matches!(
            renderer.render(&mut data, "behind"),
            Err(MujocoError::NoSuch { .. })
        ));
    }
}

#[test]
fn views_project_points_to_the_pixels_that_show_them() {
    for model in Version::ALL.into_iter().filter_map(model) {
        let mut renderer = Renderer::new(&model, 90, 60).unwrap();
        assert_eq!(renderer.view(), None, "nothing was rendered yet");
        let mut data = Data::new(&model).unwrap();
        for centre in [[0.0, 0.0, 1.2], [0.3, -0.4, 1.0], [-0.2, 0.2, 1.1]] {
            data.qpos_mut()[..3].copy_from_slice(&centre);
            data.forward();
            let image = renderer.render(&mut data, "front").unwrap();
            let (pixels, _) = image.as_chunks::<3>();
            let red: Vec<usize> = (0..pixels.len())
                .filter(|&i| pixels[i][0] > 60 && pixels[i][1] < 30 && pixels[i][2] < 30)
                .collect();
            let mean = |of: fn(usize) -> usize| red.iter().map(|&i| of(i) as f64 + 0.5).sum::<f64>() / red.len() as f64;
            let found = [mean(|i| i % 90), mean(|i| i / 90)];
            let projected = renderer.view().unwrap().pixel(centre, 90, 60).unwrap();
            let distance = (found[0] - projected[0]).hypot(found[1] - projected[1]);
            assert!(red.len() > 10 && distance < 1.5, "{centre:?}: {found:?}, {projected:?}");
        }
    }
}

#[test]
fn trimming_does_not_change_images() {
    for model in Version::ALL.into_iter().filter_map(model) {
        let mut renderer = Renderer::new(&model, 84, 84).unwrap();
        let trimmed = images(&mut renderer, &model);
        renderer.set_trimmed(false);
        let whole = images(&mut renderer, &model);
        assert!(trimmed == whole);
        let green = |pixel: [u8; 3]| pixel[1] > pixel[0].max(pixel[2]) + 5;
        assert!(count(&whole[0], green) > 0, "the wedge is visible in the mirror");
    }
}

#[test]
fn renderers_in_several_threads_give_the_same_images() {
    for model in Version::ALL.into_iter().filter_map(model) {
        let alone = images(&mut Renderer::new(&model, 84, 84).unwrap(), &model);
        std::thread::scope(|scope| {
            for _ in 0..4 {
                scope.spawn(|| {
                    // Two renderers in one thread are used alternately, and one is dropped before the other.
                    let mut first = Renderer::new(&model, 84, 84).unwrap();
                    let mut second = Renderer::new(&model, 84, 84).unwrap();
                    assert!(images(&mut second, &model) == alone && images(&mut first, &model) == alone);
                    drop(second);
                    assert!(images(&mut first, &model) == alone);
                });
            }
        });
    }
}

#[test]
fn resized_boxes_give_the_same_images_as_compiled_ones() {
    for model in Version::ALL.into_iter().filter_map(model) {
        let resized = model.with_boxes([("cube", [0.2, 0.05, 0.1])]).unwrap();
        assert!(resized.has_same_appearance(&model));
        let text = SCENE.replace("size=\"0.1 0.1 0.1\"", "size=\"0.2 0.05 0.1\"");
        let compiled = Model::compile(model.library(), &text).unwrap();
        assert!(!compiled.has_same_appearance(&model));
        let mut renderer = Renderer::new(&model, 84, 84).unwrap();
        let before = images(&mut renderer, &model);
        let after = images(&mut renderer, &resized);
        assert!(before != after && after == images(&mut Renderer::new(&compiled, 84, 84).unwrap(), &compiled));
        assert!(before == images(&mut renderer, &model));
        assert!(model.with_boxes([("floor", [1.0; 3])]).is_err() && model.with_boxes([("none", [1.0; 3])]).is_err());
    }
}

/// Checks the colours of the tiles on the table, each 0.1 m wide, in an image from above with the cube out of view.
fn assert_tiles(renderer: &mut Renderer, model: &Model) {
    let mut data = Data::new(model).unwrap();
    data.qpos_mut()[0] = 9.0;
    data.forward();
    let image = renderer.render(&mut data, "above").unwrap();
    let view = renderer.view().unwrap();
    let blue: Vec<bool> = (0..16)
        .map(|tile| {
            let [x, y] = [tile / 4, tile % 4].map(|number| -0.15 + 0.1 * f64::from(number));
            let [column, row] = view.pixel([x, y, 0.55], 84, 84).unwrap().map(|pixel| pixel as usize);
            image[3 * (84 * row + column) + 2] > 40
        })
        .collect();
    for tile in 0..16 {
        assert_eq!(blue[tile] == blue[0], (tile / 4 + tile % 4) % 2 == 0, "{blue:?}");
    }
}

#[test]
fn all_renderers_show_textures_and_shadows() {
    for plain in Version::ALL.into_iter().filter_map(model) {
        let compile = |shadows| Model::compile(plain.library(), &decorated(shadows)).unwrap();
        let (lit, shaded) = (compile(false), compile(true));
        let small = Renderer::footprint(&lit, 84, 84);
        let large = Renderer::footprint(&shaded, 84, 84);
        assert!(small.shared == large.shared && small.each + (1 << 20) < large.each);
        let mut first = Renderer::new(&lit, 84, 84).unwrap();
        let alone = images(&mut first, &lit);
        assert!(alone != images(&mut Renderer::new(&plain, 84, 84).unwrap(), &plain));
        let green = |pixel: [u8; 3]| pixel[0] == 0 && pixel[1] > 60 && pixel[2] == 0;
        let blue = |pixel: [u8; 3]| pixel[0] < 30 && pixel[2] > 60;
        assert!(count(&alone[0], green) > 100, "the sky");
        assert!(count(&alone[0], blue) > 50, "tiles of the table");
        assert_tiles(&mut first, &lit);
        let shadows = images(&mut Renderer::new(&shaded, 84, 84).unwrap(), &shaded);
        assert!(alone != shadows);
        // A renderer in another thread shares textures with the first one, and is still used after the first one is dropped.
        let (made, wait) = std::sync::mpsc::channel();
        let (gone, go) = std::sync::mpsc::channel();
        std::thread::scope(|scope| {
            let (lit, alone) = (&lit, &alone);
            scope.spawn(move || {
                let mut second = Renderer::new(lit, 84, 84).unwrap();
                made.send(()).unwrap();
                go.recv().unwrap();
                assert!(images(&mut second, lit) == *alone);
            });
            wait.recv().unwrap();
            drop(first);
            gone.send(()).unwrap();
        });
        // New renderers, after all others were dropped.
        assert_tiles(&mut Renderer::new(&lit, 84, 84).unwrap(), &lit);
        assert!(images(&mut Renderer::new(&lit, 84, 84).unwrap(), &lit) == alone);
        assert!(images(&mut Renderer::new(&shaded, 84, 84).unwrap(), &shaded) == shadows);
    }
}
