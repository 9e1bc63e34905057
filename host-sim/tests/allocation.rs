//! A tick of a driving robot allocates no memory.

use core_algos::math::Posture;
use core_algos::node::lead::Task;
use host_sim::run::robot::Robot;
use host_sim::run::simulation::Simulation;
use host_sim::scenario::Scenario;
use host_sim::targets::HostCommand;
use std::alloc::{GlobalAlloc, Layout, System};
use std::sync::atomic::{AtomicUsize, Ordering::Relaxed};

/// Number of allocations since the start of this program.
static ALLOCATIONS: AtomicUsize = AtomicUsize::new(0);

struct Counting;

// SAFETY: every call is passed on to the system's allocator.
unsafe impl GlobalAlloc for Counting {
    unsafe fn alloc(&self, layout: Layout) -> *mut u8 {
        ALLOCATIONS.fetch_add(1, Relaxed);
        // SAFETY: the caller keeps the contract of `alloc`.
        unsafe { System.alloc(layout) }
    }

    unsafe fn dealloc(&self, pointer: *mut u8, layout: Layout) {
        // SAFETY: the caller keeps the contract of `dealloc`.
        unsafe { System.dealloc(pointer, layout) }
    }
}

#[global_allocator]
static ALLOCATOR: Counting = Counting;

#[test]
fn tick_while_driving_allocates_nothing() {
    let mut robot = Simulation::new(&Scenario::default(), 1, 0).unwrap();
    let steps = |robot: &mut Simulation, ticks: usize| {
        for _ in 0..ticks {
            robot.step().unwrap();
        }
    };
    steps(&mut robot, 200);
    robot
        .command(&HostCommand::Task(Task::regulate(Posture::ORIGIN)))
        .unwrap();
    steps(&mut robot, 3000);
    assert!(robot.lead_output().motion.v > 0.02);
    let before = ALLOCATIONS.load(Relaxed);
    steps(&mut robot, 2000);
    assert_eq!(ALLOCATIONS.load(Relaxed) - before, 0);
}
