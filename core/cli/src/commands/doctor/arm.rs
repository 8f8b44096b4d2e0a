//! What the process that guards an arm may do here: real-time priority, locked memory, a folder for latched stops.

use std::process::{Command, Stdio};

use panoscope_arm_guard::check::Check;
use panoscope_arm_guard::{client, latch, realtime};

use super::State;

/// The highest real-time priority that a part of Panoscope asks for.
pub const PRIORITY: i32 = realtime::PRIORITY;

/// One line per thing: how it stands, its name, and what to do.
pub type Lines = Vec<(State, &'static str, String)>;

/// Asks the guard's program, which tries it: the rights of a program can differ from those of this one.
pub fn lines() -> Lines {
    let absent = |words: String| vec![(State::Optional, client::PROGRAM, words)];
    let program = match client::program() {
        Ok(program) => program,
        Err(error) => return absent(format!("graphs with `arm_serial` need it: {error}")),
    };
    let output = Command::new(&program).arg("--check").stdin(Stdio::null()).stderr(Stdio::null()).output();
    let text = match output {
        Ok(output) => String::from_utf8_lossy(&output.stdout).into_owned(),
        Err(error) => return absent(format!("{} cannot be started: {error}", program.display())),
    };
    match Check::read(&text) {
        Some(check) => of(&check),
        None => absent(format!("{} does not report; it belongs to another version of Panoscope", program.display())),
    }
}

fn of(check: &Check) -> Lines {
    let number = |value: Option<u64>| value.map_or_else(|| "no limit".to_owned(), |n| n.to_string());
    let priority = if check.granted.real_time {
        (State::Fine, "arm's guard, priority", format!("SCHED_FIFO {}", realtime::PRIORITY))
    } else {
        let about = format!(
            "no SCHED_FIFO {needed} (RLIMIT_RTPRIO {limit}): a busy machine may hold the guard up; the arm's own watchdog then stops the arm. For a user `me`: `me - rtprio {needed}` in /etc/security/limits.d/panoscope.conf, then log in again",
            needed = realtime::PRIORITY,
            limit = number(check.priority_limit),
        );
        (State::Optional, "arm's guard, priority", about)
    };
    let memory = if check.granted.locked_memory {
        (State::Fine, "arm's guard, locked memory", "allowed".to_owned())
    } else {
        let about = format!(
            "not allowed (RLIMIT_MEMLOCK {limit} KiB, {needed} needed): a machine that swaps may hold the guard up. For a user `me`: `me - memlock {needed}` in /etc/security/limits.d/panoscope.conf, then log in again",
            needed = realtime::MEMORY_KIB,
            limit = number(check.memory_limit_kib),
        );
        (State::Optional, "arm's guard, locked memory", about)
    };
    let folder = match &check.folder_problem {
        None => (State::Fine, "arm's latched stops", check.folder.display().to_string()),
        Some(problem) => {
            let about = format!(
                "{}: {problem}; set {} to a folder on a disk that this user may write",
                check.folder.display(),
                latch::FOLDER_VARIABLE
            );
            (State::Optional, "arm's latched stops", about)
        }
    };
    vec![priority, memory, folder]
}

#[cfg(test)]
mod tests {
    use super::*;
    use panoscope_arm_guard::realtime::Granted;

    fn check(granted: bool) -> Check {
        Check {
            granted: Granted { locked_memory: granted, real_time: granted },
            priority_limit: Some(0),
            memory_limit_kib: Some(8192),
            folder: "/somewhere/arms".into(),
            folder_problem: None,
        }
    }

    #[test]
    fn a_machine_that_grants_everything_is_fine() {
        let lines = of(&check(true));
        assert!(lines.iter().all(|(state, ..)| *state == State::Fine));
        assert!(lines.iter().any(|(_, _, about)| about.contains("/somewhere/arms")));
    }

    #[test]
    fn what_is_missing_comes_with_its_remedy() {
        let lines = of(&Check { folder_problem: Some("it is in memory".to_owned()), ..check(false) });
        let about = |state: State, words: &[&str]| {
            lines.iter().any(|(its, _, about)| *its == state && words.iter().all(|word| about.contains(word)))
        };
        assert!(about(State::Optional, &["RLIMIT_RTPRIO 0", "`me - rtprio 60`", "/etc/security/limits.d"]));
        assert!(about(State::Optional, &["RLIMIT_MEMLOCK 8192 KiB", "`me - memlock 65536`", "/etc/security/limits.d"]));
        assert!(about(State::Optional, &["/somewhere/arms: it is in memory", "PANOSCOPE_ARM_STATE"]));
    }
}
