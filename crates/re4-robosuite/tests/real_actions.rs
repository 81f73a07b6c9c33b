//! Comparison of converted absolute actions with the controller's own goals, on real files.
#![allow(clippy::unwrap_used, clippy::print_stdout, reason = "tests may panic")]

mod common;

use common::{TASKS, quantile, scripted};
use re4_robosuite::actions::{Osc, distance};
use re4_robosuite::kinematics::PANDA_RESET;

/// Errors in millimetres and degrees.
#[derive(Default)]
struct Errors {
    mm: Vec<f64>,
    degrees: Vec<f64>,
}

impl Errors {
    fn print(&mut self, what: &str) {
        let quantiles =
            |values: &mut Vec<f64>| [0.5, 0.9, 0.99, 1.0].map(|fraction| format!("{:.1e}", quantile(values, fraction)));
        let (mm, degrees) = (quantiles(&mut self.mm), quantiles(&mut self.degrees));
        println!(
            "{what}, {} steps: p50 p90 p99 max {} mm, {} deg",
            self.mm.len(),
            mm.join(" "),
            degrees.join(" ")
        );
    }
}

#[test]
fn converted_deltas_equal_the_goals_of_the_controller() {
    for task in TASKS {
        let (Some(deltas), Some(goals)) = (scripted(task, "low_dim.hdf5"), scripted(task, "low_dim_abs.hdf5")) else {
            return;
        };
        let osc = Osc::from_env(&deltas.env).unwrap();
        let [mut first, mut opening, mut later, mut all_known] = [const {
            Errors {
                mm: vec![],
                degrees: vec![],
            }
        }; 4];
        for name in goals.names() {
            let (demo, known) = (deltas.demo(&name), goals.actions(&name));
            let sites = demo.sites();
            let absolute = osc.to_absolute(&demo.actions, &sites, None).unwrap();
            // In the first step the controller holds the pose of the reset.
            let reset = demo.model.site_at(&PANDA_RESET).unwrap();
            let informed = osc.to_absolute(&demo.actions, &sites, Some(&reset)).unwrap();
            let before_rotation = demo
                .actions
                .iter()
                .take_while(|action| action[3..6] == [0.0; 3])
                .count();
            for (t, theirs) in known.iter().enumerate() {
                let (metres, radians) = distance(&absolute[t], theirs);
                let errors = match t {
                    0 => &mut first,
                    t if t < before_rotation => &mut opening,
                    _ => &mut later,
                };
                errors.mm.push(metres * 1e3);
                errors.degrees.push(radians.to_degrees());
                let (metres, radians) = distance(&informed[t], theirs);
                all_known.mm.push(metres * 1e3);
                all_known.degrees.push(radians.to_degrees());
                assert_eq!(absolute[t][6], theirs[6]);
            }
            // Back to the recorded deltas.
            let back = osc.to_delta(&known, &sites, Some(&reset)).unwrap();
            for (ours, theirs) in back.iter().zip(&demo.actions) {
                for (ours, theirs) in ours.iter().zip(theirs) {
                    assert!((ours - theirs).abs() <= 1e-6, "{task} {name}: {ours} {theirs}");
                }
            }
        }
        first.print(&format!("{task}: first step"));
        opening.print(&format!("{task}: later steps before the first rotation"));
        later.print(&format!("{task}: all other steps"));
        all_known.print(&format!("{task}: all steps, reset pose known"));
        for errors in [&mut later, &mut all_known] {
            assert!(quantile(&mut errors.mm, 1.0) <= 1e-6);
            assert!(quantile(&mut errors.degrees, 1.0) <= 1e-5);
        }
    }
}
