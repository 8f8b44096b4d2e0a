//! The whole loop without pictures holds what the arm is for.

use panoscope_arm_core::Chain;
use panoscope_arm_core::rehearsal::{Scenario, measure, play, shipped_goals};

#[test]
fn every_scenario_keeps_tip_and_trocar() {
    let chain = Chain::shipped().expect("the shipped arm");
    for scenario in Scenario::ALL {
        let rows = play(&chain, scenario, 7, 26.0, 30.0, &shipped_goals());
        let m = measure(&rows);
        println!("{:<10} {m:.2?}", scenario.name());
        assert!(m.pivot_mm < 1.0, "{}: {m:?}", scenario.name());
        assert!(m.in_view_pct > 99.9, "{}: {m:?}", scenario.name());
        assert!(rows.iter().any(|row| row.following), "{}", scenario.name());
    }
    let rest = measure(&play(&chain, Scenario::Rest, 7, 8.0, 30.0, &shipped_goals()));
    assert!(rest.rest_pct < 2.0 && rest.rest_mm.abs() < 1.0, "{rest:?}");
    let strokes = measure(&play(&chain, Scenario::Strokes, 8, 30.0, 30.0, &shipped_goals()));
    assert!(strokes.rms_mm < 3.0, "{strokes:?}");
}
