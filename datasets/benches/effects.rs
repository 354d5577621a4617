//! The look at a scene for effects of its capture, of rooms of 100 000 and 1.5 million Gaussians: all effects, and
//! what a lift of labels looks for by itself.
#![allow(missing_docs, reason = "criterion's macros make undocumented items")]

use criterion::{Criterion, Throughput, criterion_group, criterion_main};
use scenesplat_datasets::effects::Effect;
use scenesplat_datasets::effects::profile::{profile, profile_of};
use scenesplat_rooms::{SyntheticRoomSettings, generate};
use std::time::Duration;

fn profiles(c: &mut Criterion) {
    let mut group = c.benchmark_group("profile");
    for (name, count) in [("100k", 100_000), ("1500k", 1_500_000)] {
        let room = generate(&SyntheticRoomSettings::with_count(count, 7)).expect("a room").scene;
        group.throughput(Throughput::Elements(room.len() as u64));
        group.bench_function(format!("{name}/all"), |bench| bench.iter(|| profile(&room, 1.0)));
        group.bench_function(format!("{name}/glass"), |bench| {
            bench.iter(|| profile_of(&room, 1.0, &[Effect::Glass]));
        });
        // Nothing is looked for: what a command pays whose modules are all off by themselves.
        group.bench_function(format!("{name}/nothing"), |bench| {
            bench.iter(|| profile_of(&room, 1.0, &[]));
        });
    }
    group.finish();
}

/// Few samples: one is an average over many rows.
fn config() -> Criterion {
    Criterion::default()
        .sample_size(10)
        .warm_up_time(Duration::from_millis(500))
        .measurement_time(Duration::from_secs(2))
        .configure_from_args()
}

criterion_group!(name = benches; config = config(); targets = profiles);
criterion_main!(benches);
