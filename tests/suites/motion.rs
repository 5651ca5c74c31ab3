//! Promises of the motion: conservation, neighbours, kernels, order, extremes, known flows. A suite is one program, so that the engine is compiled for it once.

#[path = "../common/mod.rs"]
mod common;

#[path = "../conservation.rs"]
mod conservation;
#[path = "../convergence.rs"]
mod convergence;
#[path = "../density.rs"]
mod density;
#[path = "../determinism.rs"]
mod determinism;
#[path = "../dns.rs"]
mod dns;
#[path = "../dns_references.rs"]
mod dns_references;
#[path = "../ecs.rs"]
mod ecs;
#[path = "../extremes.rs"]
mod extremes;
#[path = "../kernel_tables.rs"]
mod kernel_tables;
#[path = "../kernels.rs"]
mod kernels;
#[path = "../neighbours.rs"]
mod neighbours;
#[path = "../order.rs"]
mod order;
#[path = "../plain_oracle.rs"]
mod plain_oracle;
#[path = "../precision.rs"]
mod precision;
#[path = "../published_flow.rs"]
mod published_flow;
#[path = "../random_scenes.rs"]
mod random_scenes;
#[path = "../reference_flows.rs"]
mod reference_flows;
#[path = "../requirements.rs"]
mod requirements;
#[path = "../scenes.rs"]
mod scenes;
#[path = "../space.rs"]
mod space;
#[path = "../symmetry.rs"]
mod symmetry;
#[path = "../watch.rs"]
mod watch;
