//! Absolute actions against the controller's own goals, on the real files.
#![allow(clippy::unwrap_used, clippy::print_stdout, reason = "a test may stop where it fails")]

mod common;

use common::{TASKS, quantile, scripted};
use re4_robosuite::actions::{Osc, distance};

#[test]
fn deltas_become_the_goals_of_the_controller() {
    for task in TASKS {
        let (Some(deltas), Some(goals)) = (scripted(task, "low_dim.hdf5"), scripted(task, "low_dim_abs.hdf5")) else {
            return;
        };
        let osc = Osc::from_env(&deltas.env).unwrap();
        let (mut first, mut later) = ([vec![], vec![]], [vec![], vec![]]);
        for name in goals.names() {
            let (demo, known) = (deltas.demo(&name), goals.actions(&name));
            let absolute = osc.to_absolute(&demo.actions, &demo.sites(), None).unwrap();
            let held = demo.actions.iter().take_while(|action| action[3..6] == [0.0; 3]).count().max(1);
            for (t, (ours, theirs)) in absolute.iter().zip(&known).enumerate() {
                let (metres, radians) = distance(ours, theirs);
                let sort = if t < held { &mut first } else { &mut later };
                sort[0].push(metres * 1e9);
                sort[1].push(radians.to_degrees() * 1e6);
                assert_eq!(ours[6], theirs[6]);
            }
        }
        for (what, sort) in [("first", &mut first), ("later", &mut later)] {
            let count = sort[0].len();
            let shares = [0.5, 0.9, 0.99, 1.0];
            let [mm, degrees] = sort.each_mut().map(|values| shares.map(|share| quantile(values, share)));
            println!("{task} {what} {count}: {mm:.1?} nm, {degrees:.2?} 1e-6 deg");
        }
        assert!(quantile(&mut later[0], 0.99) <= 1.0 && quantile(&mut later[1], 0.99) <= 100.0);
    }
}
