//! Which connections are open, and which one gives way to another.

use std::net::{Shutdown, TcpStream};
use std::sync::{Mutex, MutexGuard, PoisonError};
use std::time::{Duration, Instant};

/// Connections that are answered at a time.
const MOST: usize = 16;
/// How long a request may take to come, and an answer may stand still, where others wait for their turn.
const GRACE: Duration = Duration::from_millis(100);
const STILL: Duration = Duration::from_secs(1);

/// The open connections.
#[derive(Debug, Default)]
pub(super) struct Connections(Mutex<Vec<Open>>);

#[derive(Debug)]
struct Open {
    id: u64,
    stream: TcpStream,
    /// When it came, or when a part of its answer last went out.
    moved: Instant,
    /// Whether its request is complete.
    is_answered: bool,
}

impl Connections {
    /// Makes room for another: if there are too many, the one that has been idle for longest is closed. `false`: none
    /// is idle.
    pub(super) fn make_room(&self) -> bool {
        let mut all = self.all();
        if all.len() < MOST {
            return true;
        }
        let limit = |open: &Open| if open.is_answered { STILL } else { GRACE };
        let idle = (0..all.len()).filter(|i| all[*i].moved.elapsed() > limit(&all[*i]));
        let Some(longest) = idle.min_by_key(|i| all[*i].moved) else { return false };
        // Who waits for bytes of it hears of its end at once.
        let _ = all.swap_remove(longest).stream.shutdown(Shutdown::Both);
        true
    }

    /// Adds one; `false` if the system does not let it be closed from here.
    pub(super) fn add(&self, id: u64, stream: &TcpStream) -> bool {
        let Ok(stream) = stream.try_clone() else { return false };
        self.all().push(Open { id, stream, moved: Instant::now(), is_answered: false });
        true
    }

    /// Notes that its request came, or that a part of its answer went out.
    pub(super) fn moved(&self, id: u64) {
        if let Some(open) = self.all().iter_mut().find(|open| open.id == id) {
            (open.moved, open.is_answered) = (Instant::now(), true);
        }
    }

    /// Forgets one that ended.
    pub(super) fn remove(&self, id: u64) {
        self.all().retain(|open| open.id != id);
    }

    fn all(&self) -> MutexGuard<'_, Vec<Open>> {
        self.0.lock().unwrap_or_else(PoisonError::into_inner)
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use std::net::{Ipv4Addr, TcpListener};

    #[test]
    fn the_longest_idle_one_makes_room_and_no_other() {
        let listener = TcpListener::bind((Ipv4Addr::LOCALHOST, 0)).unwrap();
        let port = listener.local_addr().unwrap().port();
        let stream = || TcpStream::connect((Ipv4Addr::LOCALHOST, port)).unwrap();
        let all = Connections::default();
        for id in 0..MOST as u64 {
            assert!(all.make_room() && all.add(id, &stream()));
        }
        assert!(!all.make_room(), "all have just come");
        std::thread::sleep(2 * GRACE);
        // The first gets an answer: it is the second that has waited for longest.
        all.moved(0);
        assert!(all.make_room());
        let ids: Vec<u64> = all.all().iter().map(|open| open.id).collect();
        assert!(ids.contains(&0) && !ids.contains(&1) && ids.len() == MOST - 1, "{ids:?}");
        all.remove(5);
        assert!(all.make_room() && all.all().len() == MOST - 2, "there was room");
    }
}
