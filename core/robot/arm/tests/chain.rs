//! The shipped arm, its Jacobian, and files that are wrong.

use nalgebra::{Point3, Vector3};
use panoscope_arm_core::chain::SHIPPED_URDF;
use panoscope_arm_core::task::{self, Wanted};
use panoscope_arm_core::{Chain, JOINTS, JointVector};

fn chain() -> Chain {
    Chain::shipped().expect("the shipped arm")
}

fn angles(seed: u64) -> JointVector {
    let mut random = panoscope_arm_core::campaign::Random::new(seed);
    JointVector::from_fn(|_, _| (random.unit() - 0.5) * 0.8)
}

#[test]
fn home_looks_down_at_the_trocars_place() {
    let chain = chain();
    let home = chain.stance(&JointVector::zeros());
    let at = home.base_from_camera.translation.vector;
    assert!((at - Vector3::new(412.5, 0.0, 100.0)).norm() < 1e-9, "{at}");
    assert!((home.base_from_camera * Vector3::z() + Vector3::z()).norm() < 1e-9, "looks down");
    let trocar = home.trocar_in_tip(&chain.trocar_mm());
    assert!((trocar - Vector3::new(0.0, 0.0, -110.0)).norm() < 1e-9, "{trocar}");
}

#[test]
fn links_are_as_long_in_every_pose_and_end_at_the_camera() {
    let chain = chain();
    let lengths = |links: &[Point3<f64>]| links.windows(2).map(|pair| (pair[1] - pair[0]).norm()).collect::<Vec<_>>();
    let home = lengths(&chain.stance(&JointVector::zeros()).links());
    assert!((home[0] - 200.0).abs() < 1e-9, "the first joint stands 200 mm above the foot: {home:?}");
    for seed in 0..20 {
        let stance = chain.stance(&angles(seed));
        let links = stance.links();
        assert_eq!(links[0], Point3::origin());
        assert_eq!(links[links.len() - 1].coords, stance.base_from_camera.translation.vector);
        assert!(lengths(&links).iter().zip(&home).all(|(a, b)| (a - b).abs() < 1e-9));
    }
}

#[test]
fn the_jacobian_is_the_derivative_of_the_pose() {
    let chain = chain();
    for seed in 0..20 {
        let q = angles(seed);
        let stance = chain.stance(&q);
        let in_camera = Point3::new(3.0, -4.0, 50.0);
        let jacobian = stance.jacobian(&(stance.base_from_camera * in_camera));
        for k in 0..JOINTS {
            let mut ahead = q;
            ahead[k] += 1e-6;
            let moved = chain.stance(&ahead).base_from_camera;
            let linear = (moved * in_camera - stance.base_from_camera * in_camera) / 1e-6;
            let turn = (moved.rotation * stance.base_from_camera.rotation.inverse()).scaled_axis() / 1e-6;
            assert!((linear - jacobian.fixed_view::<3, 1>(0, k)).norm() < 1e-2, "seed {seed} joint {k}");
            assert!((turn - jacobian.fixed_view::<3, 1>(3, k)).norm() < 1e-4, "seed {seed} joint {k}");
        }
        let speeds = angles(seed + 100);
        let camera = stance.jacobian(&Point3::from(stance.base_from_camera.translation.vector));
        assert!((stance.camera_velocity(&speeds) - (camera * speeds).fixed_rows::<3>(0)).norm() < 1e-9);
    }
}

#[test]
fn a_movement_that_is_asked_for_happens_about_the_trocar() {
    let chain = chain();
    let up = chain.stance(&JointVector::zeros()).base_from_camera * -Vector3::y();
    let mut q = JointVector::zeros();
    // Walk to somewhere within reach, keeping to the trocar, then ask.
    for step in 0..400 {
        let stance = chain.stance(&q);
        let velocity_mm_s = Vector3::new(10.0, if step < 200 { -8.0 } else { 6.0 }, -4.0);
        let point_mm = Vector3::new(7.5, 0.0, 65.0);
        let solved = task::solve(&chain, &q, &stance, &up, &Wanted { point_mm, velocity_mm_s });
        let room = stance.base_from_camera * Point3::from(point_mm);
        let next = q + solved.velocity * 1e-3;
        let after = chain.stance(&next);
        let moved = (after.base_from_camera.inverse_transform_point(&room).coords - point_mm) / 1e-3;
        assert!((moved - velocity_mm_s).norm() < 0.2, "step {step}: {moved}");
        let off = after.trocar_in_tip(&chain.trocar_mm());
        assert!(off.x.hypot(off.y) < 0.02, "step {step}: {off}");
        assert!(task::roll_rad(&after, &up).abs() < 0.02, "{}", task::roll_rad(&after, &up));
        assert!(solved.singular > 0.1, "{}", solved.singular);
        q += solved.velocity * 0.01;
    }
    assert!(q.amax() > 0.1, "it went somewhere: {q}");
}

#[test]
fn an_offset_from_the_trocar_and_a_crooked_horizon_go_back() {
    let chain = chain();
    let up = chain.stance(&JointVector::zeros()).base_from_camera * -Vector3::y();
    let mut q = JointVector::from_column_slice(&[0.005, 0.0, -0.004, 0.01, 0.003, 0.2]);
    let wanted = Wanted { point_mm: Vector3::new(7.5, 0.0, 65.0), velocity_mm_s: Vector3::zeros() };
    for _ in 0..400 {
        let stance = chain.stance(&q);
        q += task::solve(&chain, &q, &stance, &up, &wanted).velocity * 0.01;
    }
    let stance = chain.stance(&q);
    let off = stance.trocar_in_tip(&chain.trocar_mm());
    assert!(
        off.x.hypot(off.y) < 0.01 && task::roll_rad(&stance, &up).abs() < 0.01,
        "{off} {}",
        task::roll_rad(&stance, &up)
    );
}

#[test]
fn near_singular_poses_and_limits_nothing_runs_away() {
    let chain = chain();
    let up = chain.stance(&JointVector::zeros()).base_from_camera * -Vector3::y();
    let wanted = Wanted { point_mm: Vector3::new(7.5, 0.0, 65.0), velocity_mm_s: Vector3::new(20.0, 20.0, 20.0) };
    // The wrist stretched out: two axes fall together.
    let bend = (0.270f64).atan2(0.080);
    for off in [0.0, 1e-9, 1e-6, 1e-3, 1e-2] {
        let q = JointVector::from_column_slice(&[0.0, 0.0, 0.0, 0.0, -bend + off, 0.0]);
        let solved = task::solve(&chain, &q, &chain.stance(&q), &up, &wanted);
        assert!(solved.velocity.iter().all(|v| v.is_finite()));
    }
    // A joint at its limit does not go on.
    let mut q = JointVector::zeros();
    for k in 0..JOINTS {
        q[k] = chain.joints()[k].upper_rad;
        let solved = task::solve(&chain, &q, &chain.stance(&q), &up, &wanted);
        assert!(solved.velocity[k] <= 1e-12, "joint {k}: {}", solved.velocity[k]);
        q[k] = 0.0;
    }
    for bad in [f64::NAN, f64::INFINITY] {
        let wanted = Wanted { point_mm: Vector3::new(bad, 0.0, 65.0), velocity_mm_s: Vector3::zeros() };
        let solved = task::solve(&chain, &JointVector::zeros(), &chain.stance(&JointVector::zeros()), &up, &wanted);
        assert_eq!(solved.velocity, JointVector::zeros());
    }
}

#[test]
fn wrong_files_are_refused_with_the_place() {
    let cases = [
        ("", "not a URDF"),
        ("<robot name=\"a\"></robot>", "`left_camera`"),
        (&SHIPPED_URDF.replace("\"left_camera\"", "\"eye\""), "`left_camera`"),
        (&SHIPPED_URDF.replace("<link name=\"trocar\"/>", ""), "`trocar`"),
        (&SHIPPED_URDF.replace("xyz=\"0.42 0 0.21\"", "xyz=\"0.40 0 0.21\""), "20.0 mm off the axis"),
        (&SHIPPED_URDF.replace("name=\"bend\" type=\"revolute\"", "name=\"bend\" type=\"fixed\""), "5 joints move"),
        (
            &SHIPPED_URDF.replace("name=\"bend\" type=\"revolute\"", "name=\"bend\" type=\"prismatic\""),
            "`bend` is Prismatic",
        ),
        (&SHIPPED_URDF.replace("lower=\"-1.4\"", "lower=\"NaN\""), "`bend`: the lower limit is NaN"),
        (&SHIPPED_URDF.replace("lower=\"-1.4\"", "lower=\"0.4\""), "home, with all joints at 0"),
        (
            &SHIPPED_URDF.replace("effort=\"40\" velocity=\"0.4\"", "effort=\"40\" velocity=\"0\""),
            "`bend`: the speed limit is 0",
        ),
        (
            &SHIPPED_URDF.replace("<axis xyz=\"0.958798 0 -0.284088\"/>", "<axis xyz=\"0 0 0\"/>"),
            "`forearm_roll`: the axis' length",
        ),
        (
            &SHIPPED_URDF.replace(
                "<parent link=\"base_link\"/><child link=\"turret\"/>",
                "<parent link=\"wrist\"/><child link=\"turret\"/>",
            ),
            "cycle",
        ),
    ];
    for (text, words) in cases {
        let refused = Chain::from_urdf(text).map(|_| ()).expect_err(words).to_string();
        assert!(refused.contains(words), "{refused}");
    }
}
