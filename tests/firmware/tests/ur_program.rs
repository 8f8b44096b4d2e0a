//! `panoscope_arm.script`, the program of a Universal Robots controller, cycle by cycle: when it follows, and when it does not.

use panoscope_arm_core::campaign::Random;
use panoscope_firmware::urscript::{Motion, Program, Robot};

const PROGRAM: &str = include_str!("../../../core/robot/arm_guard/ur/panoscope_arm.script");

const HOLD: i32 = 0;
const FOLLOW: i32 = 1;
const RELEASE: i32 = 2;
const STOPPED: i32 = 1;
const READY: i32 = 2;
const FOLLOWS: i32 = 3;

/// A controller with an ideal arm, which is always at its target.
struct Bench {
    program: Program,
    io: Io,
    beat: i32,
    /// Motion of the arm in the newest cycle.
    motion: Motion,
}

struct Io {
    ints: [i32; 48],
    floats: [f64; 48],
    outputs: [i32; 48],
    angles: [f64; 6],
    step_s: f64,
}

impl Robot for Io {
    fn input_int(&self, register: usize) -> i32 {
        self.ints[register]
    }
    fn input_float(&self, register: usize) -> f64 {
        self.floats[register]
    }
    fn set_output_int(&mut self, register: usize, value: i32) {
        self.outputs[register] = value;
    }
    fn angles(&self) -> [f64; 6] {
        self.angles
    }
    fn step_s(&self) -> f64 {
        self.step_s
    }
}

impl Bench {
    fn new(step_s: f64) -> Self {
        let io = Io { ints: [0; 48], floats: [0.0; 48], outputs: [0; 48], angles: [0.5; 6], step_s };
        let program = Program::read(PROGRAM).expect("a program");
        Self { program, io, beat: 100, motion: Motion::None }
    }

    /// One control cycle. Returns the program's state.
    fn cycle(&mut self) -> i32 {
        self.motion = self.program.cycle(&mut self.io, !matches!(self.motion, Motion::Servo(_))).expect("it runs");
        if let Motion::Servo(target) = self.motion {
            self.io.angles = target;
        }
        self.state()
    }

    fn state(&self) -> i32 {
        self.io.outputs[25]
    }

    fn is_driven(&self) -> bool {
        matches!(self.motion, Motion::Servo(_))
    }

    /// Writes a package into the registers.
    fn put(&mut self, command: i32, targets: [f64; 6]) {
        self.beat = (self.beat + 1) % 1_000_000;
        self.io.floats[24..30].copy_from_slice(&targets);
        let weighted: f64 = (0..6).map(|k| (k + 1) as f64 * (targets[k] * 1e6).round()).sum();
        self.io.ints[24] = self.beat;
        self.io.ints[25] = command;
        self.io.ints[26] = weighted as i32 + 100 * self.beat + 1000 * command;
    }

    fn send(&mut self, command: i32) -> i32 {
        self.put(command, self.io.angles);
        self.cycle()
    }

    /// A bench that is released and following.
    fn following(step_s: f64) -> Self {
        let mut bench = Self::new(step_s);
        for command in [HOLD, HOLD, RELEASE, HOLD, FOLLOW, FOLLOW] {
            bench.send(command);
        }
        assert_eq!(bench.state(), FOLLOWS);
        bench
    }
}

#[test]
fn it_starts_stopped_and_says_what_it_is() {
    let mut bench = Bench::new(0.002);
    for _ in 0..50 {
        assert_eq!(bench.cycle(), STOPPED);
        assert_eq!(bench.motion, Motion::None);
    }
    assert_eq!((bench.io.outputs[26], bench.io.outputs[27], bench.io.outputs[28]), (1, 1, 30));
    // To follow is no release.
    for _ in 0..50 {
        assert_eq!(bench.send(FOLLOW), STOPPED);
        assert_eq!(bench.motion, Motion::None);
    }
    assert_eq!(bench.io.outputs[24], bench.beat, "the heartbeat is echoed all the same");
}

#[test]
fn a_release_needs_a_hold_after_the_stop_and_a_heartbeat() {
    // A release that was left in the registers.
    let mut bench = Bench::new(0.002);
    bench.put(RELEASE, [0.5; 6]);
    for _ in 0..50 {
        assert_eq!(bench.cycle(), STOPPED);
    }
    // One that is sent again and again, but no hold before it.
    for _ in 0..50 {
        assert_eq!(bench.send(RELEASE), STOPPED);
    }
    assert_eq!(bench.send(HOLD), STOPPED);
    assert_eq!(bench.send(RELEASE), READY);
    assert_eq!(bench.motion, Motion::None, "a release moves nothing");
    // The hold before a stop does not count after it.
    bench.send(FOLLOW);
    for _ in 0..20 {
        bench.cycle();
    }
    assert_eq!(bench.state(), STOPPED);
    assert_eq!(bench.send(RELEASE), STOPPED);
    assert_eq!(bench.send(HOLD), STOPPED);
    assert_eq!(bench.send(RELEASE), READY);
}

#[test]
fn it_brakes_within_30_ms_of_the_last_heartbeat() {
    for step_s in [0.002, 0.008] {
        let mut bench = Bench::following(step_s);
        bench.send(FOLLOW);
        assert!(bench.is_driven());
        let mut silent = 0;
        while bench.is_driven() {
            bench.cycle();
            silent += 1;
            assert!(f64::from(silent) * step_s <= 0.030 + 1e-9, "still driven after {silent} cycles of {step_s} s");
        }
        assert_eq!(bench.motion, Motion::Stop(4.0));
        assert!(f64::from(silent) * step_s > 0.015, "one lost package is no silence: {silent} cycles of {step_s} s");
        assert_eq!((bench.state(), bench.io.outputs[26]), (STOPPED, 2));
        // It stays stopped, whatever heartbeats come.
        for _ in 0..100 {
            assert_eq!(bench.send(FOLLOW), STOPPED);
            assert!(!bench.is_driven());
        }
    }
}

#[test]
fn the_same_heartbeat_again_is_none() {
    let mut bench = Bench::following(0.002);
    for k in 0..15 {
        // New targets, but the number of the package before.
        let mut target = bench.io.angles;
        target[5] += 1e-4 * f64::from(k);
        bench.put(FOLLOW, target);
        bench.beat -= 1;
        bench.io.ints[24] = bench.beat;
        bench.io.ints[26] -= 100;
        bench.cycle();
    }
    assert_eq!(bench.state(), STOPPED);
    assert_eq!(bench.io.angles, [0.5; 6]);
}

#[test]
fn it_follows_targets_and_holds() {
    let mut bench = Bench::following(0.002);
    for _ in 0..100 {
        let mut target = bench.io.angles;
        target[5] += 0.0008;
        bench.put(FOLLOW, target);
        assert_eq!(bench.cycle(), FOLLOWS);
        bench.cycle();
        assert_eq!(bench.motion, Motion::Servo(target));
    }
    bench.send(HOLD);
    assert_eq!(bench.state(), READY);
    assert_eq!(bench.cycle(), READY);
    assert!(!bench.is_driven());
    // No heartbeat is needed where nothing moves.
    for _ in 0..100 {
        assert_eq!(bench.cycle(), READY);
    }
    // Numbers start again at 0.
    bench.beat = 999_998;
    for _ in 0..4 {
        assert_eq!(bench.send(FOLLOW), FOLLOWS);
    }
    assert_eq!(bench.beat, 2);
}

#[test]
fn a_far_target_stops_it() {
    for joint in 0..6 {
        for off in [0.2, -0.2] {
            let mut bench = Bench::following(0.002);
            let mut target = bench.io.angles;
            target[joint] += off;
            bench.put(FOLLOW, target);
            assert_eq!(bench.cycle(), STOPPED);
            assert_eq!(bench.io.outputs[26], 3);
            bench.cycle();
            assert!(!bench.is_driven());
            assert_eq!(bench.io.angles, [0.5; 6]);
        }
    }
}

#[test]
fn damaged_and_half_packages_move_nothing() {
    let mut random = Random::new(29);
    for _ in 0..3000 {
        let mut bench = Bench::following(0.002);
        let before = bench.io.angles;
        let mut target = before;
        target[random.of(6) as usize] += 0.01;
        let old = (bench.io.floats, bench.io.ints);
        bench.put(FOLLOW, target);
        // A flipped bit anywhere, or some registers of the package before.
        let register = 24 + random.of(6) as usize;
        match random.of(4) {
            0 => bench.io.floats[register] = f64::from_bits(bench.io.floats[register].to_bits() ^ (1 << random.of(64))),
            1 => bench.io.ints[24 + random.of(3) as usize] ^= 1 << random.of(32),
            2 => bench.io.floats = old.0,
            _ => bench.io.ints[26] = old.1[26],
        }
        bench.cycle();
        bench.cycle();
        let moved = (0..6).map(|k| (bench.io.angles[k] - before[k]).abs()).fold(0.0, f64::max);
        // A flipped bit that is worth less than the rounding of the sum comes through.
        let is_whole = (0..6).all(|k| (bench.io.angles[k] - target[k]).abs() < 5e-5);
        assert!(moved == 0.0 || is_whole, "moved by {moved}");
    }
    // Numbers that are none.
    for value in [f64::NAN, f64::INFINITY, f64::NEG_INFINITY, 1e300] {
        let mut bench = Bench::following(0.002);
        bench.put(FOLLOW, bench.io.angles);
        bench.io.floats[26] = value;
        bench.cycle();
        bench.cycle();
        assert_eq!(bench.io.angles, [0.5; 6]);
    }
    for value in [i32::MIN, i32::MAX, -1, 1_000_000] {
        let mut bench = Bench::following(0.002);
        for register in 24..27 {
            bench.put(FOLLOW, bench.io.angles);
            bench.io.ints[register] = value;
            bench.cycle();
        }
        assert_eq!(bench.io.angles, [0.5; 6]);
    }
}
