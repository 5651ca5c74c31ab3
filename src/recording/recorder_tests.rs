//! The queue of the recorder.

use super::super::Recording;
use super::*;
use std::sync::atomic::{AtomicUsize, Ordering};

const PARTICLES: usize = 300;
const FRAMES: usize = 60;

fn frame(step: usize) -> Frame {
    let rows = (0..PARTICLES).map(|k| [k as f64, step as f64, (k * step) as f64]);
    Frame::new(step as u64, step as f64, rows.clone(), rows, vec![1.0; PARTICLES])
}

fn recorder(path: &Path) -> Result<Recorder> {
    let run = RunInfo {
        scene_toml: "name = \"test\"\n".into(),
        dimension: 3,
        box_length: 1.0,
        sides: Vec::new(),
        boundary: Vec::new(),
        speed_scale: 1.0,
        parameters: vec![],
        metadata: Default::default(),
    };
    Recorder::create(path, &run)
}

#[test]
fn no_frame_is_lost_and_memory_stays_bounded_when_the_disk_stands_still() -> Result<()> {
    let folder = std::env::temp_dir().join(format!("whirls-still-{}", std::process::id()));
    let path = folder.join("still.mcap");
    let mut recorder = recorder(&path)?;
    // The writing thread blocks here until its answer is received.
    let (done, wait) = sync_channel(0);
    recorder.order(Order::Checkpoint(done))?;
    let accepted = AtomicUsize::new(0);
    std::thread::scope(|scope| {
        let run = scope.spawn(|| -> Result<()> {
            for step in 0..FRAMES {
                recorder.frame(Flow::Truth, frame(step))?;
                accepted.fetch_add(1, Ordering::SeqCst);
            }
            recorder.checkpoint()
        });
        while accepted.load(Ordering::SeqCst) < QUEUE - 1 {
            std::thread::yield_now();
        }
        std::thread::sleep(std::time::Duration::from_millis(50));
        assert!(accepted.load(Ordering::SeqCst) <= QUEUE, "the run waits for the disk");
        assert!(wait.recv().is_ok());
        run.join().unwrap_or_else(|_| panic!("the run panicked"))
    })?;
    // All memory that was allocated has been returned.
    let made: Vec<Vec<u8>> = recorder.written.try_iter().collect();
    let bytes: usize = made.iter().map(Vec::capacity).sum();
    assert!(made.len() <= QUEUE + 2, "{} clouds in memory", made.len());
    assert!(bytes <= PARTICLES * Recorder::MOST_BYTES + made.len() * 512, "{bytes} bytes");
    recorder.finish()?;
    let recording = Recording::open(&path)?;
    assert_eq!(recording.frame_count(Flow::Truth), FRAMES);
    for step in 0..FRAMES {
        assert_eq!(recording.frame(Flow::Truth, step)?, frame(step));
    }
    std::fs::remove_dir_all(folder).map_err(|error| Error::write(&path, error))
}

#[test]
fn a_disk_that_keeps_up_is_given_the_same_memory_again() -> Result<()> {
    let folder = std::env::temp_dir().join(format!("whirls-again-{}", std::process::id()));
    let mut recorder = recorder(&folder.join("again.mcap"))?;
    for step in 0..FRAMES {
        recorder.frame(Flow::Truth, frame(step))?;
        recorder.checkpoint()?;
    }
    assert_eq!(recorder.written.try_iter().count(), 1);
    recorder.finish()?;
    std::fs::remove_dir_all(&folder).map_err(|error| Error::write(&folder, error))
}
