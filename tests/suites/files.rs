//! Promises of what comes in and goes out: recordings, arrays, tables, and data that contradict themselves. A suite is one program, so that the engine is compiled for it once.

#[path = "../common/place.rs"]
mod place;
#[path = "../common/small.rs"]
mod small;

#[path = "../cases.rs"]
mod cases;
#[path = "../corruptions.rs"]
mod corruptions;
#[path = "../door.rs"]
mod door;
#[path = "../export.rs"]
mod export;
#[path = "../import.rs"]
mod import;
#[path = "../recording_round_trip.rs"]
mod recording_round_trip;
#[path = "../tables.rs"]
mod tables;
