//! A bounded channel that, when full, drops its oldest entry instead of refusing the newest.
//!
//! A live camera does not wait: a slow receiver must get the newest frame and the number of dropped
//! ones. Plain crossbeam channels block or refuse. The sender here also holds a receiver and uses
//! it to make room. The stream ends for the receiver once the sender is dropped and the remaining
//! entries have been read.

use crossbeam_channel::{Receiver, TrySendError, bounded};

/// The sending end.
#[derive(Debug)]
pub struct DropOldestSender<T> {
    sender: crossbeam_channel::Sender<T>,
    /// Used only to remove the oldest entry.
    drain: Receiver<T>,
}

/// Creates a channel that holds at most `capacity` entries (at least 1).
pub fn drop_oldest<T>(capacity: usize) -> (DropOldestSender<T>, Receiver<T>) {
    let (sender, receiver) = bounded(capacity.max(1));
    (DropOldestSender { sender, drain: receiver.clone() }, receiver)
}

impl<T> DropOldestSender<T> {
    /// Sends without ever waiting; returns the number of oldest entries dropped to make room.
    pub fn send(&self, entry: T) -> usize {
        self.send_dropping(entry, |_| {})
    }

    /// Like [`send`](Self::send), passing each dropped entry to `on_drop`.
    pub fn send_dropping(&self, entry: T, mut on_drop: impl FnMut(T)) -> usize {
        let mut entry = entry;
        let mut dropped = 0;
        loop {
            match self.sender.try_send(entry) {
                Ok(()) => return dropped,
                // `drain` keeps the channel connected, so in practice this is always `Full`.
                Err(TrySendError::Full(back) | TrySendError::Disconnected(back)) => entry = back,
            }
            if let Ok(oldest) = self.drain.try_recv() {
                dropped += 1;
                on_drop(oldest);
            }
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn the_newest_survive_in_order() {
        let (sender, receiver) = drop_oldest(3);
        let dropped: usize = (0..10).map(|k| sender.send(k)).sum();
        assert_eq!(dropped, 7);
        drop(sender);
        assert_eq!(receiver.iter().collect::<Vec<_>>(), [7, 8, 9]);
    }

    #[test]
    fn the_stream_ends_after_the_last_entry() {
        let (sender, receiver) = drop_oldest(2);
        sender.send('a');
        drop(sender);
        assert_eq!(receiver.recv(), Ok('a'));
        assert!(receiver.recv().is_err());
    }

    #[test]
    fn a_vanished_reader_never_blocks_the_sender() {
        let (sender, receiver) = drop_oldest(2);
        drop(receiver);
        for k in 0..100 {
            sender.send(k);
        }
        assert_eq!(sender.drain.len(), 2);
    }

    #[test]
    fn a_concurrent_reader_sees_increasing_entries_and_the_last() {
        let (sender, receiver) = drop_oldest(4);
        let reader = std::thread::spawn(move || receiver.iter().collect::<Vec<u32>>());
        for k in 0..20_000 {
            sender.send(k);
        }
        drop(sender);
        let seen = reader.join().expect("the reader does not panic");
        assert!(seen.windows(2).all(|w| w[0] < w[1]));
        assert_eq!(seen.last(), Some(&19_999));
    }
}
