//! Runs other programs, shows their output and reports their failures.

use std::io::{BufRead, BufReader, Write};
use std::path::{Path, PathBuf};
use std::process::{Command, ExitStatus, Stdio};

use anyhow::{Context, Result, bail};

/// Lines of a silent command's output that are shown when it fails.
const TAIL_LINES: usize = 20;

/// The command as typed in a shell.
pub fn shown(command: &Command) -> String {
    let program = Path::new(command.get_program());
    let words = std::iter::once(program.file_name().unwrap_or(command.get_program())).chain(command.get_args());
    words.map(|word| quoted(&word.to_string_lossy())).collect::<Vec<_>>().join(" ")
}

fn quoted(word: &str) -> String {
    let plain = |c: char| c.is_ascii_alphanumeric() || "-_./=:+,@%".contains(c);
    if !word.is_empty() && word.chars().all(plain) {
        word.to_owned()
    } else {
        format!("'{}'", word.replace('\'', "'\\''"))
    }
}

/// Runs a command whose output goes straight to the terminal.
pub fn run(command: &mut Command) -> Result<()> {
    let status = command.status().with_context(|| format!("cannot start `{}`", shown(command)))?;
    check(command, status)
}

/// Runs a command silently and returns its standard output; the error of a failure has the end of its output.
pub fn capture(command: &mut Command) -> Result<String> {
    let output = command.stdin(Stdio::null()).output().with_context(|| format!("cannot start `{}`", shown(command)))?;
    let stdout = String::from_utf8_lossy(&output.stdout).into_owned();
    if !output.status.success() {
        let said = format!("{stdout}{}", String::from_utf8_lossy(&output.stderr));
        bail!("`{}` failed ({})\n{}", shown(command), output.status, tail(&said, TAIL_LINES));
    }
    Ok(stdout)
}

/// Runs a command and hands every line of its standard output to `on_line`, which returns whether to print it. Standard
/// error goes straight to the terminal.
pub fn filter(command: &mut Command, mut on_line: impl FnMut(&str) -> bool) -> Result<ExitStatus> {
    let mut child =
        command.stdout(Stdio::piped()).spawn().with_context(|| format!("cannot start `{}`", shown(command)))?;
    let stdout = child.stdout.take().context("the child's output is not readable")?;
    let mut reader = BufReader::new(stdout);
    let mut line = Vec::new();
    while reader.read_until(b'\n', &mut line)? > 0 {
        let text = String::from_utf8_lossy(&line);
        let text = text.trim_end_matches(['\n', '\r']);
        if on_line(text) {
            writeln!(std::io::stdout(), "{text}")?;
        }
        line.clear();
    }
    Ok(child.wait()?)
}

/// Turns a failed status into an error that names the command.
pub fn check(command: &Command, status: ExitStatus) -> Result<()> {
    if !status.success() {
        bail!("`{}` failed ({status})", shown(command));
    }
    Ok(())
}

/// The last lines of a text.
pub fn tail(text: &str, lines: usize) -> String {
    let all: Vec<&str> = text.lines().collect();
    all[all.len().saturating_sub(lines)..].join("\n")
}

/// Searches PATH for a program.
pub fn find_program(name: &str) -> Option<PathBuf> {
    let path = std::env::var_os("PATH")?;
    std::env::split_paths(&path).map(|dir| dir.join(name)).find(|file| file.is_file())
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn commands_are_shown_as_typed() {
        let mut command = Command::new("/opt/rust/bin/cargo");
        command.args(["test", "--workspace", "a b", "it's", ""]);
        assert_eq!(shown(&command), r"cargo test --workspace 'a b' 'it'\''s' ''");
    }

    #[test]
    fn a_silent_command_that_fails_tells_its_end() {
        let error = capture(Command::new("sh").args(["-c", "echo first; echo reason >&2; exit 3"])).unwrap_err();
        let text = format!("{error:#}");
        assert!(text.contains("reason") && text.contains("exit status: 3"), "{text}");
    }

    #[test]
    fn lines_are_handed_over_without_their_ends() {
        let mut seen = Vec::new();
        let status = filter(Command::new("printf").arg("a\\nb\\r\\nc"), |line| {
            seen.push(line.to_owned());
            false
        });
        assert!(status.unwrap().success());
        assert_eq!(seen, ["a", "b", "c"]);
    }

    #[test]
    fn the_tail_is_the_end() {
        assert_eq!(tail("1\n2\n3\n", 2), "2\n3");
        assert_eq!(tail("1", 5), "1");
    }
}
