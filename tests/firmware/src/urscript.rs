//! An interpreter for the subset of URScript that `panoscope_arm.script` uses, so that tests run the same text as the robot.
//!
//! Supported: one `def` with assignments (`global`, `local` or plain), `while`, `if`, `elif`, `else`, threads, `run`, numbers, booleans, lists of
//! numbers, and the built-in functions of [`Program::call`]. Integers have 32 bits; an overflow ends the program, as does any other error. Threads
//! run in turn once per control cycle, until `sync`, `servoj` or `stopj`.

use std::collections::HashMap;

/// Maximum number of statements of one thread in one control cycle; more is a loop that never waits.
const MAX_STATEMENTS: u32 = 10_000;

/// Interface of the program to the robot.
pub trait Robot {
    /// Integer input register.
    fn input_int(&self, register: usize) -> i32;
    /// Floating-point input register.
    fn input_float(&self, register: usize) -> f64;
    /// Writes an integer output register.
    fn set_output_int(&mut self, register: usize, value: i32);
    /// Measured joint angles, rad.
    fn angles(&self) -> [f64; 6];
    /// Length of a control cycle, s.
    fn step_s(&self) -> f64;
}

/// Motion of the arm in a control cycle.
#[derive(Clone, Copy, Debug, PartialEq)]
pub enum Motion {
    /// No thread moves it.
    None,
    /// Moves toward these angles, rad.
    Servo([f64; 6]),
    /// Brakes, rad/s^2.
    Stop(f64),
}

#[derive(Clone, Debug, PartialEq)]
enum Value {
    Bool(bool),
    Int(i32),
    Float(f64),
    List(Vec<f64>),
}

#[derive(Clone, Debug)]
enum Expr {
    Const(Value),
    Name(String),
    List(Vec<Expr>),
    Index(Box<Expr>, Box<Expr>),
    Not(Box<Expr>),
    Minus(Box<Expr>),
    Binary(&'static str, Box<Expr>, Box<Expr>),
    Call(String, Vec<Expr>),
    Run(String),
}

#[derive(Clone, Copy, Debug, PartialEq)]
enum Scope {
    Plain,
    Local,
    Global,
}

#[derive(Clone, Debug)]
enum Op {
    Assign(Scope, String, Expr),
    Do(Expr),
    JumpUnless(Expr, usize),
    Jump(usize),
}

/// Statements with their line numbers.
type Code = Vec<(usize, Op)>;

enum Block {
    Def,
    Thread { name: String, outer: Code },
    While { start: usize, exit: usize },
    If { exits: Vec<usize>, pending: Option<usize> },
}

#[derive(Debug)]
struct Task {
    code: usize,
    at: usize,
    locals: HashMap<String, Value>,
    is_main: bool,
    /// Deceleration of a running `stopj`, rad/s^2, until the arm is at rest.
    is_braking: Option<f64>,
}

/// A running program.
#[derive(Debug)]
pub struct Program {
    codes: Vec<Code>,
    threads: HashMap<String, usize>,
    globals: HashMap<String, Value>,
    plain: HashMap<String, Value>,
    tasks: Vec<Task>,
}

// --- reading

fn tokens(line: &str) -> Result<Vec<String>, String> {
    let mut out = Vec::new();
    let mut rest = line;
    loop {
        rest = rest.trim_start();
        let Some(first) = rest.chars().next().filter(|c| *c != '#') else { return Ok(out) };
        let length = if first == '"' {
            rest[1..].find('"').ok_or("a text without end")? + 2
        } else if first.is_ascii_alphabetic() || first == '_' {
            rest.find(|c: char| !c.is_ascii_alphanumeric() && c != '_').unwrap_or(rest.len())
        } else if first.is_ascii_digit() {
            rest.find(|c: char| !c.is_ascii_digit() && c != '.').unwrap_or(rest.len())
        } else if ["==", "!=", "<=", ">="].iter().any(|two| rest.starts_with(two)) {
            2
        } else if "()[],+-*/<>=:".contains(first) {
            1
        } else {
            return Err(format!("unknown character `{first}`"));
        };
        out.push(rest[..length].to_owned());
        rest = &rest[length..];
    }
}

struct Parser {
    tokens: Vec<String>,
    at: usize,
}

impl Parser {
    fn peek(&self) -> &str {
        self.tokens.get(self.at).map_or("", String::as_str)
    }

    fn next(&mut self) -> String {
        let token = self.peek().to_owned();
        self.at += 1;
        token
    }

    fn take(&mut self, token: &str) -> bool {
        let is_it = self.peek() == token;
        self.at += usize::from(is_it);
        is_it
    }

    fn expect(&mut self, token: &str) -> Result<(), String> {
        if self.take(token) { Ok(()) } else { Err(format!("`{token}` is needed before `{}`", self.peek())) }
    }

    fn end(&self) -> Result<(), String> {
        if self.at >= self.tokens.len() { Ok(()) } else { Err(format!("`{}` is too much", self.peek())) }
    }

    /// Left-associative operators by precedence, lowest first.
    fn binary(&mut self, level: usize) -> Result<Expr, String> {
        const LEVELS: [&[&str]; 5] = [&["or"], &["and"], &["==", "!=", "<=", ">=", "<", ">"], &["+", "-"], &["*", "/"]];
        let Some(operators) = LEVELS.get(level) else { return self.unary() };
        if level == 2 && self.take("not") {
            return Ok(Expr::Not(Box::new(self.binary(2)?)));
        }
        let mut left = self.binary(level + 1)?;
        while let Some(operator) = operators.iter().find(|operator| self.peek() == **operator) {
            self.at += 1;
            left = Expr::Binary(operator, Box::new(left), Box::new(self.binary(level + 1)?));
        }
        Ok(left)
    }

    fn unary(&mut self) -> Result<Expr, String> {
        if self.take("-") {
            return Ok(Expr::Minus(Box::new(self.unary()?)));
        }
        let token = self.next();
        let first = token.chars().next().unwrap_or(' ');
        let mut value = if token == "(" {
            let inner = self.binary(0)?;
            self.expect(")")?;
            inner
        } else if token == "[" {
            Expr::List(self.arguments("]")?)
        } else if token == "run" {
            let name = self.next();
            self.expect("(")?;
            self.expect(")")?;
            Expr::Run(name)
        } else if first.is_ascii_digit() {
            let wrong = || format!("`{token}` is not a number");
            Expr::Const(if token.contains('.') {
                Value::Float(token.parse().map_err(|_| wrong())?)
            } else {
                Value::Int(token.parse().map_err(|_| wrong())?)
            })
        } else if first == '"' {
            Expr::Const(Value::List(Vec::new()))
        } else if token == "True" || token == "False" {
            Expr::Const(Value::Bool(token == "True"))
        } else if first.is_ascii_alphabetic() || first == '_' {
            if self.take("(") { Expr::Call(token, self.arguments(")")?) } else { Expr::Name(token) }
        } else {
            return Err(format!("a value is needed before `{token}`"));
        };
        while self.take("[") {
            let index = self.binary(0)?;
            self.expect("]")?;
            value = Expr::Index(Box::new(value), Box::new(index));
        }
        Ok(value)
    }

    fn arguments(&mut self, close: &str) -> Result<Vec<Expr>, String> {
        let mut out = Vec::new();
        while !self.take(close) {
            if !out.is_empty() {
                self.expect(",")?;
            }
            out.push(self.binary(0)?);
        }
        Ok(out)
    }
}

struct Compiler {
    code: Code,
    codes: Vec<Code>,
    threads: HashMap<String, usize>,
    blocks: Vec<Block>,
    has_ended: bool,
}

impl Compiler {
    fn line(&mut self, number: usize, text: &str) -> Result<(), String> {
        let mut parser = Parser { tokens: tokens(text)?, at: 0 };
        if parser.tokens.is_empty() {
            return Ok(());
        }
        if self.has_ended || (self.blocks.is_empty() && parser.peek() != "def") {
            return Err("a program is one `def`".to_owned());
        }
        match parser.peek() {
            word @ ("def" | "thread") => {
                let is_thread = word == "thread";
                parser.at += 1;
                let name = parser.next();
                parser.expect("(")?;
                parser.expect(")")?;
                parser.expect(":")?;
                let is_outermost = self.blocks.is_empty();
                self.blocks.push(match (is_thread, is_outermost) {
                    (false, true) => Block::Def,
                    (true, false) => Block::Thread { name, outer: std::mem::take(&mut self.code) },
                    _ => return Err(format!("`{name}` cannot stand here")),
                });
            }
            "while" => {
                let start = self.code.len();
                let condition = Self::condition(&mut parser)?;
                self.blocks.push(Block::While { start, exit: start });
                self.code.push((number, Op::JumpUnless(condition, 0)));
            }
            "if" => {
                let condition = Self::condition(&mut parser)?;
                self.blocks.push(Block::If { exits: Vec::new(), pending: Some(self.code.len()) });
                self.code.push((number, Op::JumpUnless(condition, 0)));
            }
            word @ ("elif" | "else") => {
                let is_else = word == "else";
                let here = self.code.len();
                let Some(Block::If { exits, pending }) = self.blocks.last_mut() else {
                    return Err("there is no `if` to this".to_owned());
                };
                let open = pending.take().ok_or("there is an `else` already")?;
                exits.push(here);
                self.code.push((number, Op::Jump(0)));
                self.target(open, here + 1);
                if is_else {
                    parser.at += 1;
                    parser.expect(":")?;
                } else {
                    let condition = Self::condition(&mut parser)?;
                    if let Some(Block::If { pending, .. }) = self.blocks.last_mut() {
                        *pending = Some(here + 1);
                    }
                    self.code.push((number, Op::JumpUnless(condition, 0)));
                }
            }
            "end" => {
                parser.at += 1;
                self.close(number)?;
            }
            _ => {
                let op = Self::statement(&mut parser)?;
                self.code.push((number, op));
            }
        }
        parser.end()
    }

    fn condition(parser: &mut Parser) -> Result<Expr, String> {
        parser.at += 1;
        let condition = parser.binary(0)?;
        parser.expect(":")?;
        Ok(condition)
    }

    fn statement(parser: &mut Parser) -> Result<Op, String> {
        let scope = match parser.peek() {
            "global" => Scope::Global,
            "local" => Scope::Local,
            _ => Scope::Plain,
        };
        parser.at += usize::from(scope != Scope::Plain);
        if parser.tokens.get(parser.at + 1).is_some_and(|token| token == "=") {
            let name = parser.next();
            parser.at += 1;
            return Ok(Op::Assign(scope, name, parser.binary(0)?));
        }
        match parser.binary(0)? {
            call @ Expr::Call(..) if scope == Scope::Plain => Ok(Op::Do(call)),
            _ => Err("neither an assignment nor a call".to_owned()),
        }
    }

    fn target(&mut self, op: usize, to: usize) {
        match &mut self.code[op].1 {
            Op::JumpUnless(_, target) | Op::Jump(target) => *target = to,
            Op::Assign(..) | Op::Do(_) => {}
        }
    }

    fn close(&mut self, number: usize) -> Result<(), String> {
        match self.blocks.pop().ok_or("there is nothing to end")? {
            Block::Def => self.has_ended = true,
            Block::Thread { name, outer } => {
                self.codes.push(std::mem::replace(&mut self.code, outer));
                self.threads.insert(name, self.codes.len());
            }
            Block::While { start, exit } => {
                self.code.push((number, Op::Jump(start)));
                self.target(exit, self.code.len());
            }
            Block::If { exits, pending } => {
                for jump in exits.into_iter().chain(pending) {
                    self.target(jump, self.code.len());
                }
            }
        }
        Ok(())
    }
}

// --- running

impl Program {
    /// Parses a program.
    ///
    /// # Errors
    /// The line, and what is wrong in it.
    pub fn read(text: &str) -> Result<Self, String> {
        let mut compiler = Compiler {
            code: Vec::new(),
            codes: Vec::new(),
            threads: HashMap::new(),
            blocks: Vec::new(),
            has_ended: false,
        };
        for (index, line) in text.lines().enumerate() {
            compiler.line(index + 1, line).map_err(|error| format!("line {}: {error}", index + 1))?;
        }
        if !compiler.has_ended {
            return Err("the program has no end".to_owned());
        }
        let mut codes = vec![compiler.code];
        codes.extend(compiler.codes);
        let main = Task { code: 0, at: 0, locals: HashMap::new(), is_main: true, is_braking: None };
        let threads = compiler.threads;
        Ok(Self { codes, threads, globals: HashMap::new(), plain: HashMap::new(), tasks: vec![main] })
    }

    /// Runs one control cycle. `is_still`: the arm is at rest.
    ///
    /// # Errors
    /// The program has ended, with an error or without.
    pub fn cycle(&mut self, robot: &mut dyn Robot, is_still: bool) -> Result<Motion, String> {
        let mut motion = Motion::None;
        let mut index = 0;
        while index < self.tasks.len() {
            let mut task = self.tasks.remove(index);
            if is_still {
                task.is_braking = None;
            }
            let moved = match task.is_braking {
                Some(rad_s2) => Motion::Stop(rad_s2),
                None => self.resume(&mut task, robot)?,
            };
            if moved != Motion::None {
                if motion != Motion::None {
                    return Err("two threads move the arm".to_owned());
                }
                motion = moved;
            }
            // New threads stand behind this one.
            self.tasks.insert(index, task);
            index += 1;
        }
        Ok(motion)
    }

    /// Runs a thread until it waits.
    fn resume(&mut self, task: &mut Task, robot: &mut dyn Robot) -> Result<Motion, String> {
        for _ in 0..MAX_STATEMENTS {
            let Some((line, op)) = self.codes[task.code].get(task.at).cloned() else {
                return Err("the program has ended".to_owned());
            };
            task.at += 1;
            let placed = |error: String| format!("line {line}: {error}");
            match op {
                Op::Jump(to) => task.at = to,
                Op::JumpUnless(condition, to) => match self.value(&condition, task, robot).map_err(placed)? {
                    Value::Bool(true) => {}
                    Value::Bool(false) => task.at = to,
                    other => return Err(placed(format!("{other:?} is not a truth value"))),
                },
                Op::Assign(scope, name, value) => {
                    let value = self.value(&value, task, robot).map_err(placed)?;
                    self.assign(scope, name, value, task);
                }
                Op::Do(Expr::Call(name, arguments)) => {
                    let arguments =
                        arguments.iter().map(|it| self.value(it, task, robot)).collect::<Result<Vec<_>, _>>();
                    let arguments = arguments.map_err(placed)?;
                    match (name.as_str(), arguments.as_slice()) {
                        ("sync", []) => return Ok(Motion::None),
                        ("servoj", [Value::List(target), _, _, Value::Float(seconds), Value::Float(_), _]) => {
                            if (*seconds - robot.step_s()).abs() > 1e-9 {
                                return Err(placed("servoj for another time than a control cycle".to_owned()));
                            }
                            let target =
                                target.as_slice().try_into().map_err(|_| placed("no six joints".to_owned()))?;
                            return Ok(Motion::Servo(target));
                        }
                        ("stopj", [Value::Float(rad_s2)]) => {
                            task.is_braking = Some(*rad_s2);
                            return Ok(Motion::Stop(*rad_s2));
                        }
                        _ => {
                            Self::call(&name, &arguments, robot).map_err(placed)?;
                        }
                    }
                }
                Op::Do(_) => {}
            }
        }
        Err("a loop that never waits".to_owned())
    }

    fn assign(&mut self, scope: Scope, name: String, value: Value, task: &mut Task) {
        let is_global = self.globals.contains_key(&name) && !task.locals.contains_key(&name);
        match scope {
            Scope::Local => &mut task.locals,
            Scope::Global => &mut self.globals,
            Scope::Plain if is_global => &mut self.globals,
            Scope::Plain if task.is_main => &mut self.plain,
            Scope::Plain => &mut task.locals,
        }
        .insert(name, value);
    }

    fn value(&mut self, expr: &Expr, task: &Task, robot: &mut dyn Robot) -> Result<Value, String> {
        Ok(match expr {
            Expr::Const(value) => value.clone(),
            Expr::Name(name) => {
                let scopes = [&task.locals, &self.globals, &self.plain];
                let found = scopes.into_iter().find_map(|scope| scope.get(name));
                found.cloned().ok_or_else(|| format!("`{name}` has no value"))?
            }
            Expr::List(values) => {
                let mut out = Vec::new();
                for value in values {
                    out.push(float(&self.value(value, task, robot)?)?);
                }
                Value::List(out)
            }
            Expr::Index(list, index) => {
                let (Value::List(list), Value::Int(index)) =
                    (self.value(list, task, robot)?, self.value(index, task, robot)?)
                else {
                    return Err("no element of a list".to_owned());
                };
                let element = usize::try_from(index).ok().and_then(|index| list.get(index).copied());
                Value::Float(element.ok_or_else(|| format!("the list has no element {index}"))?)
            }
            Expr::Not(inner) => match self.value(inner, task, robot)? {
                Value::Bool(value) => Value::Bool(!value),
                other => return Err(format!("`not` of {other:?}")),
            },
            Expr::Minus(inner) => match self.value(inner, task, robot)? {
                Value::Int(value) => Value::Int(value.checked_neg().ok_or("the number does not fit")?),
                other => Value::Float(-float(&other)?),
            },
            Expr::Binary(operator, left, right) => {
                // Both sides are always computed: nothing may rely on either order.
                let (left, right) = (self.value(left, task, robot)?, self.value(right, task, robot)?);
                binary(operator, &left, &right)?
            }
            Expr::Call(name, arguments) => {
                let arguments =
                    arguments.iter().map(|it| self.value(it, task, robot)).collect::<Result<Vec<_>, _>>()?;
                Self::call(name, &arguments, robot)?
            }
            Expr::Run(name) => {
                let code = *self.threads.get(name).ok_or_else(|| format!("there is no thread `{name}`"))?;
                self.tasks.push(Task { code, at: 0, locals: HashMap::new(), is_main: false, is_braking: None });
                Value::Int(self.tasks.len() as i32)
            }
        })
    }

    /// Calls a built-in function that does not wait.
    fn call(name: &str, arguments: &[Value], robot: &mut dyn Robot) -> Result<Value, String> {
        let register = |value: &Value| match value {
            Value::Int(n @ 0..48) => Ok(*n as usize),
            other => Err(format!("there is no register {other:?}")),
        };
        Ok(match (name, arguments) {
            ("read_input_integer_register", [n]) => Value::Int(robot.input_int(register(n)?)),
            ("read_input_float_register", [n]) => Value::Float(robot.input_float(register(n)?)),
            ("write_output_integer_register", [n, Value::Int(value)]) => {
                robot.set_output_int(register(n)?, *value);
                Value::Bool(true)
            }
            ("get_actual_joint_positions", []) => Value::List(robot.angles().to_vec()),
            ("get_steptime", []) => Value::Float(robot.step_s()),
            ("textmsg", [_]) => Value::Bool(true),
            ("floor", [Value::Float(value)]) => {
                let whole = value.floor();
                let fits = whole.abs() < f64::from(i32::MAX);
                if !fits {
                    return Err(format!("the floor of {value} does not fit"));
                }
                Value::Int(whole as i32)
            }
            _ => return Err(format!("there is no `{name}` of {arguments:?}")),
        })
    }
}

fn float(value: &Value) -> Result<f64, String> {
    match value {
        Value::Int(value) => Ok(f64::from(*value)),
        Value::Float(value) => Ok(*value),
        other => Err(format!("{other:?} is not a number")),
    }
}

fn binary(operator: &str, left: &Value, right: &Value) -> Result<Value, String> {
    if let (Value::Bool(left), Value::Bool(right)) = (left, right) {
        return match operator {
            "and" => Ok(Value::Bool(*left && *right)),
            "or" => Ok(Value::Bool(*left || *right)),
            "==" => Ok(Value::Bool(left == right)),
            "!=" => Ok(Value::Bool(left != right)),
            _ => Err(format!("`{operator}` of truth values")),
        };
    }
    if let (Value::Int(left), Value::Int(right)) = (left, right) {
        let whole = match operator {
            "+" => Some(left.checked_add(*right)),
            "-" => Some(left.checked_sub(*right)),
            "*" => Some(left.checked_mul(*right)),
            "/" => return Err("a quotient of whole numbers".to_owned()),
            _ => None,
        };
        if let Some(whole) = whole {
            return whole.map(Value::Int).ok_or_else(|| "the number does not fit".to_owned());
        }
    }
    let (a, b) = (float(left)?, float(right)?);
    Ok(match operator {
        "+" => Value::Float(a + b),
        "-" => Value::Float(a - b),
        "*" => Value::Float(a * b),
        "/" => Value::Float(a / b),
        "<" => Value::Bool(a < b),
        ">" => Value::Bool(a > b),
        "<=" => Value::Bool(a <= b),
        ">=" => Value::Bool(a >= b),
        "==" => Value::Bool(a == b),
        "!=" => Value::Bool(a != b),
        _ => return Err(format!("`{operator}` of numbers")),
    })
}
