//! Which process a temporary file or a lock belongs to, so that those of dead processes can be told.

use std::path::Path;

/// A process, by what no later one has in common with it.
#[derive(Debug, Clone, PartialEq, Eq)]
pub(crate) struct Owner {
    /// Its number.
    pub pid: u32,
    /// When it started, in ticks since the machine did; 0 where the system does not tell. Numbers of
    /// processes are used again, the two together are not.
    start: u64,
    /// Digest of the machine and of the container on it: numbers of processes mean nothing elsewhere.
    machine: String,
}

/// A process as `/proc` knows it.
struct Known {
    start: u64,
    /// Ended, though its parent has not asked for its exit code.
    ended: bool,
}

impl Owner {
    /// This process.
    pub fn current() -> Self {
        let pid = std::process::id();
        // Not kept: after a fork, the child is another owner.
        let start = known("self").map_or(0, |k| k.start);
        let space = std::fs::read_link("/proc/self/ns/pid").unwrap_or_default();
        let machine = blake3::hash(format!("{}\n{}", host(), space.display()).as_bytes());
        Self { pid, start, machine: machine.to_hex()[..8].to_owned() }
    }

    /// As it stands in a file's name.
    pub fn tag(&self) -> String {
        format!("{}-{}-{}", self.pid, self.start, self.machine)
    }

    /// What [`tag`](Self::tag) wrote, at the start of `text`.
    pub fn parse(text: &str) -> Option<Self> {
        let mut parts = text.split('-');
        let (pid, start) = (parts.next()?.parse().ok()?, parts.next()?.parse().ok()?);
        let machine = parts.next().filter(|m| m.len() == 8 && m.bytes().all(|b| b.is_ascii_hexdigit()))?;
        Some(Self { pid, start, machine: machine.to_owned() })
    }

    /// Whether it surely runs no more: never said of a process of another machine, nor where the system
    /// does not list processes.
    pub fn is_dead(&self) -> bool {
        let here = Self::current();
        if self.machine != here.machine || here.start == 0 || self.start == 0 {
            return false;
        }
        known(&self.pid.to_string()).is_none_or(|k| k.start != self.start || k.ended)
    }

    /// Whether only a lock can tell if it runs: it is of this machine, and the system does not list processes.
    pub fn is_known_by_lock(&self) -> bool {
        self.machine == Self::current().machine && self.start == 0
    }

    /// Whether it surely runs now, and is not this process.
    pub fn is_another_alive(&self) -> bool {
        let here = Self::current();
        self.machine == here.machine && here.start != 0 && *self != here && !self.is_dead()
    }
}

/// Name of this machine.
pub(crate) fn host() -> String {
    let named = |file: &str| std::fs::read_to_string(file).ok();
    let name = named("/proc/sys/kernel/hostname").or_else(|| named("/etc/hostname"));
    let name = name.or_else(|| std::env::var("HOSTNAME").or_else(|_| std::env::var("COMPUTERNAME")).ok());
    name.map(|n| n.trim().to_owned()).filter(|n| !n.is_empty()).unwrap_or_else(|| "unknown".to_owned())
}

fn known(process: &str) -> Option<Known> {
    let text = std::fs::read(Path::new("/proc").join(process).join("stat")).ok()?;
    parse_stat(&String::from_utf8_lossy(&text))
}

/// State and start of a process, the 3rd and 22nd field of its `stat` (proc(5)).
fn parse_stat(text: &str) -> Option<Known> {
    // The 2nd is the program's name in brackets, which may hold anything.
    let mut fields = text.rsplit_once(')')?.1.split_whitespace();
    let ended = matches!(fields.next()?, "Z" | "X" | "x");
    Some(Known { ended, start: fields.nth(18)?.parse().ok()? })
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn start_and_state_are_read_past_any_program_name() {
        let stat = "42 (a) R (b c) Z 1 2 3 4 5 6 7 8 9 10 11 12 13 14 15 16 17 18 777 20";
        let known = parse_stat(stat).unwrap();
        assert_eq!((known.start, known.ended), (777, true));
        assert!(parse_stat("42 (x) R 1 2").is_none());
    }

    #[test]
    fn a_tag_comes_back_and_other_names_are_no_tags() {
        let owner = Owner::current();
        assert_eq!(Owner::parse(&format!("{}-aB3xyz.part", owner.tag())), Some(owner));
        for other in ["aB3xyz.part", "12-34-xyz", "12-34-0123456789", "", "a-b-c"] {
            assert_eq!(Owner::parse(other), None, "{other}");
        }
    }

    #[cfg(target_os = "linux")]
    #[test]
    fn a_process_is_dead_once_it_ended_or_another_has_its_number() {
        let owner = Owner::current();
        assert!(!owner.is_dead() && !owner.is_another_alive());
        assert!(Owner { start: owner.start + 1, ..owner.clone() }.is_dead());
        assert!(!Owner { machine: "00000000".to_owned(), start: 1, ..owner.clone() }.is_dead());
        let mut child = std::process::Command::new("sleep").arg("60").spawn().unwrap();
        let start = known(&child.id().to_string()).unwrap().start;
        let other = Owner { pid: child.id(), start, ..owner };
        assert!(!other.is_dead() && other.is_another_alive());
        child.kill().unwrap();
        child.wait().unwrap();
        assert!(other.is_dead() && !other.is_another_alive());
    }
}
