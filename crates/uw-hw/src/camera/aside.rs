//! A device whose library takes its own time, such as three seconds until a camera is given up that is gone: it lives on a thread of its
//! own, and whoever asks it waits no longer than he may.

use std::{
    io,
    sync::mpsc::{Receiver, Sender, channel},
    time::Duration,
};

/// How long a device may take to be let go.
const LEAVE: Duration = Duration::from_secs(1);

type Call<D> = Box<dyn FnOnce(&D) + Send>;

/// A device on a thread of its own. When this is dropped, the device is.
pub(super) struct Aside<D> {
    calls: Option<Sender<Call<D>>>,
    /// Hears of the thread's end.
    ended: Receiver<()>,
    late: bool,
}

impl<D: Send + 'static> Aside<D> {
    /// Moves a device to a thread.
    ///
    /// # Errors
    /// The system has no thread to give.
    pub fn new(name: &str, device: D) -> io::Result<Self> {
        let (calls, asked) = channel::<Call<D>>();
        let (end, ended) = channel();
        std::thread::Builder::new().name(name.to_owned()).spawn(move || {
            asked.into_iter().for_each(|call| call(&device));
            drop(device);
            drop(end);
        })?;
        Ok(Self { calls: Some(calls), ended, late: false })
    }

    /// What the device answers; `None` where it takes longer. It is then asked all the same, after what it is still at.
    pub fn ask<T: Send + 'static>(
        &mut self,
        within: Duration,
        what: impl FnOnce(&D) -> T + Send + 'static,
    ) -> Option<T> {
        let (answer, answered) = channel();
        // Nobody may hear the answer any more.
        self.leave(move |device| drop(answer.send(what(device))));
        let got = answered.recv_timeout(within).ok();
        self.late = got.is_none();
        got
    }

    /// Has the device do something that nobody waits for.
    pub fn leave(&self, what: impl FnOnce(&D) + Send + 'static) {
        if let Some(calls) = &self.calls {
            // The thread is there as long as this is.
            let _ = calls.send(Box::new(what));
        }
    }

    /// Whether it did not answer the last time.
    pub fn is_late(&self) -> bool {
        self.late
    }
}

impl<D> Drop for Aside<D> {
    fn drop(&mut self) {
        self.calls = None;
        if !self.late {
            let _ = self.ended.recv_timeout(LEAVE);
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use std::{
        sync::{Arc, Mutex},
        time::Instant,
    };

    /// Far longer than any deadline here.
    const HANGS: Duration = Duration::from_secs(3);

    struct Device(Arc<Mutex<Vec<&'static str>>>);

    impl Device {
        fn note(&self, what: &'static str) -> usize {
            let mut said = self.0.lock().unwrap();
            said.push(what);
            said.len()
        }
    }

    impl Drop for Device {
        fn drop(&mut self) {
            self.note("dropped");
        }
    }

    #[test]
    fn answers_come_in_order_and_the_device_is_let_go_at_the_end() {
        let said = Arc::<Mutex<Vec<_>>>::default();
        let mut aside = Aside::new("device", Device(said.clone())).unwrap();
        let ask = |aside: &mut Aside<Device>, what| aside.ask(HANGS, move |device| device.note(what));
        assert_eq!([ask(&mut aside, "one"), ask(&mut aside, "two")], [Some(1), Some(2)]);
        assert!(!aside.is_late());
        drop(aside);
        assert_eq!(*said.lock().unwrap(), ["one", "two", "dropped"]);
    }

    #[test]
    fn nobody_waits_for_a_device_that_hangs() {
        let said = Arc::<Mutex<Vec<_>>>::default();
        let mut aside = Aside::new("device", Device(said.clone())).unwrap();
        let began = Instant::now();
        let within = Duration::from_millis(30);
        assert_eq!(aside.ask(within, |_| std::thread::sleep(HANGS)), None);
        assert!(aside.is_late());
        assert_eq!(aside.ask(within, |device| device.note("after")), None);
        drop(aside);
        assert!(began.elapsed() < HANGS / 2, "{:?}", began.elapsed());
        assert_eq!(said.lock().unwrap().len(), 0);
    }

    #[test]
    fn a_device_that_was_late_once_is_asked_again() {
        let mut aside = Aside::new("device", ()).unwrap();
        let within = Duration::from_millis(20);
        assert_eq!(aside.ask(within, move |()| std::thread::sleep(5 * within)), None);
        assert_eq!(aside.ask(HANGS, |()| 7), Some(7));
        assert!(!aside.is_late());
    }
}
