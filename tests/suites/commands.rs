//! Promises of the programs: what they print, write and refuse. A suite is one program, so that the engine is compiled for it once.

#[path = "../common/place.rs"]
mod place;
#[path = "../common/small.rs"]
mod small;

#[path = "../assimilation.rs"]
mod assimilation;
#[path = "../commands.rs"]
mod commands;
#[path = "../dns_scenes.rs"]
mod dns_scenes;
#[path = "../door_commands.rs"]
mod door_commands;
#[path = "../first_hour.rs"]
mod first_hour;
#[path = "../outputs.rs"]
mod outputs;
#[path = "../replay_page.rs"]
mod replay_page;
