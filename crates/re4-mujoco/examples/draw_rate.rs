//! Pictures a second.
#![allow(clippy::unwrap_used, clippy::print_stdout, missing_docs, reason = "x")]
use re4_mujoco::*;
use std::path::Path;
use std::time::Instant;
fn main() {
    let a: Vec<String> = std::env::args().collect();
    let folder = Path::new("/tmp/re4/simulators");
    let library = Library::open(&folder.join("mujoco-2.3.7"), Version::V2_3_7).unwrap();
    let mjcf = std::fs::read_to_string(&a[1]).unwrap();
    let t = Instant::now();
    let model = Model::compile(&library, &mjcf).unwrap();
    println!("compile {:?}", t.elapsed());
    let raw = std::fs::read(&a[2]).unwrap();
    let numbers: Vec<f64> = raw
        .chunks_exact(8)
        .map(|b| f64::from_le_bytes(b.try_into().unwrap()))
        .collect();
    let width = 1 + model.nq() + model.nv();
    let truth = std::fs::read(&a[3]).unwrap();
    let threads: usize = a[4].parse().unwrap();
    let t = Instant::now();
    std::thread::scope(|scope| {
        for _ in 0..threads {
            scope.spawn(|| {
                let t = Instant::now();
                let mut renderer = Renderer::new(&model, 84, 84).unwrap();
                println!("context {:?}", t.elapsed());
                let mut data = Data::new(&model).unwrap();
                let mut worst = 0;
                let (mut tf, mut td) = (0.0, 0.0);
                let mut bytes = truth.chunks_exact(84 * 84 * 3);
                let mut n = 0;
                for camera in ["agentview", "robot0_eye_in_hand"] {
                    let (mut f, mut d) = (0.0, 0.0);
                    for row in numbers.chunks_exact(width) {
                        let t = Instant::now();
                        data.qpos_mut().copy_from_slice(&row[1..1 + model.nq()]);
                        data.qvel_mut().copy_from_slice(&row[1 + model.nq()..]);
                        data.forward();
                        f += t.elapsed().as_secs_f64();
                        let t = Instant::now();
                        let picture = renderer.draw(&mut data, camera).unwrap();
                        d += t.elapsed().as_secs_f64();
                        let want = bytes.next().unwrap();
                        worst = worst.max(picture.iter().zip(want).map(|(a, b)| a.abs_diff(*b)).max().unwrap());
                        n += 1;
                    }
                    let k = 1000.0 * 2.0 / n as f64;
                    println!("{camera} forward {} ms draw {} ms", f * k, d * k);
                    tf += f;
                    td += d;
                }
                println!("{n} frames, worst {worst}, forward {tf} draw {td}");
            });
        }
    });
    println!("{:?}", t.elapsed());
}
