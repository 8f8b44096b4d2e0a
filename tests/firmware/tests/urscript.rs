//! The interpreter of URScript, on programs of a few lines.

use panoscope_firmware::urscript::{Motion, Program, Robot};

struct Registers([i32; 48]);

impl Robot for Registers {
    fn input_int(&self, register: usize) -> i32 {
        register as i32
    }
    fn input_float(&self, register: usize) -> f64 {
        register as f64 * 0.5
    }
    fn set_output_int(&mut self, register: usize, value: i32) {
        self.0[register] = value;
    }
    fn angles(&self) -> [f64; 6] {
        [0.0, 0.1, 0.2, 0.3, 0.4, 0.5]
    }
    fn step_s(&self) -> f64 {
        0.002
    }
}

/// Runs the lines of a program until it waits for the first time, and returns output register 0.
fn result(lines: &str) -> Result<i32, String> {
    let mut robot = Registers([0; 48]);
    let mut program = Program::read(&format!("def p():\n{lines}\nwhile (True):\nsync()\nend\nend\n"))?;
    program.cycle(&mut robot, true)?;
    Ok(robot.0[0])
}

fn put(value: &str) -> Result<i32, String> {
    result(&format!("write_output_integer_register(0, {value})"))
}

#[test]
fn values_are_computed() {
    for (value, expected) in [
        ("1 + 2 * 3", 7),
        ("(1 + 2) * 3", 9),
        ("10 - 4 - 3", 3),
        ("-3 + 1", -2),
        ("floor(2.75)", 2),
        ("floor(-2.25)", -3),
        ("floor(7.0 / 2.0 + 0.6)", 4),
        ("read_input_integer_register(24) - 4", 20),
        ("floor([1.0, 5.0, 9.0][1])", 5),
        ("floor(get_actual_joint_positions()[5] * 100.0 + 0.5)", 50),
    ] {
        assert_eq!(put(value), Ok(expected), "{value}");
    }
}

#[test]
fn branches_and_loops_run() {
    let branch = |n: i32| {
        let lines = [
            &format!("x = {n}"),
            "if (x < 1):",
            "y = 10",
            "elif (x < 2):",
            "y = 20",
            "elif ((x == 2) or (x == 3)):",
            "y = 30",
            "else:",
            "y = 40",
            "end",
            "write_output_integer_register(0, y)",
        ];
        result(&lines.join("\n"))
    };
    for (n, expected) in [(0, 10), (1, 20), (2, 30), (3, 30), (4, 40)] {
        assert_eq!(branch(n), Ok(expected), "{n}");
    }
    let sum = "k = 0\ns = 0\nwhile (k < 5):\nif (not (k == 3)):\ns = s + k\nend\nk = k + 1\nend\nwrite_output_integer_register(0, s)";
    assert_eq!(result(sum), Ok(7));
}

#[test]
fn mistakes_end_a_program_with_their_line() {
    for (lines, words) in [
        ("x = y", "line 2: `y` has no value"),
        ("write_output_integer_register(0, 2147483647 + 1)", "does not fit"),
        ("x = [1.0][1]", "no element 1"),
        ("x = 1 / 2", "quotient"),
        ("x = floor(0.0 / 0.0)", "does not fit"),
        ("if (1):\nend", "not a truth value"),
        ("write_output_integer_register(48, 1)", "no register"),
        ("movej([0.0])", "there is no `movej`"),
        ("while (True):\nx = 1\nend", "never waits"),
    ] {
        let error = result(lines).expect_err(lines);
        assert!(error.contains(words), "{lines}: {error}");
    }
    for text in [
        "def p():\nx = 1\n",
        "x = 1\n",
        "def p():\nx = (1\nend\n",
        "def p():\nx = 1 2\nend\n",
        "def p():\nelse:\nend\nend\n",
    ] {
        assert!(Program::read(text).is_err(), "{text}");
    }
}

#[test]
fn threads_run_once_per_cycle_beside_a_braking_one() {
    let text = [
        "def p():",
        "global n = 0",
        "thread count():",
        "while (True):",
        "n = n + 1",
        "write_output_integer_register(0, n)",
        "sync()",
        "end",
        "end",
        "t = run count()",
        "servoj([0.0, 0.0, 0.0, 0.0, 0.0, 1.0], 0, 0, get_steptime(), 0.1, 300)",
        "stopj(4.0)",
        "write_output_integer_register(1, 1)",
        "while (True):",
        "sync()",
        "end",
        "end",
    ];
    let (mut program, mut robot) = (Program::read(&text.join("\n")).expect("a program"), Registers([0; 48]));
    assert_eq!(program.cycle(&mut robot, true), Ok(Motion::Servo([0.0, 0.0, 0.0, 0.0, 0.0, 1.0])));
    for cycle in 2..6 {
        assert_eq!(program.cycle(&mut robot, false), Ok(Motion::Stop(4.0)), "stopj waits until the arm stands");
        assert_eq!((robot.0[0], robot.0[1]), (cycle, 0));
    }
    assert_eq!(program.cycle(&mut robot, true), Ok(Motion::None));
    assert_eq!((robot.0[0], robot.0[1]), (6, 1));
}
