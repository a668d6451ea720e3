//! What the control loops call of ROS allocates nothing and gives nothing back: new subscribers, full sockets and
//! subscribers who leave included.
//!
//! A file of its own, since the allocator that counts is the whole program's.
#![allow(
    unsafe_code,
    reason = "an allocator can only be written as unsafe code; it passes everything on"
)]

use std::{
    alloc::{GlobalAlloc, Layout, System},
    cell::Cell,
    net::{Ipv4Addr, TcpListener},
    time::Duration,
};

use simulation::ros::float64_multi_array::{Encoder, MESSAGE_TYPE, decode};
use workload::ros::{Master, Node, NodeConfig, Notices, PublishOutcome, Publisher};

thread_local! {
    static CALLS: Cell<u64> = const { Cell::new(0) };
}

struct Counting;

// SAFETY: every call goes to the system's allocator unchanged; what is counted beside it is a plain thread-local
// number that needs no allocation.
unsafe impl GlobalAlloc for Counting {
    unsafe fn alloc(&self, layout: Layout) -> *mut u8 {
        CALLS.set(CALLS.get() + 1);
        // SAFETY: as the caller promises.
        unsafe { System.alloc(layout) }
    }

    unsafe fn dealloc(&self, pointer: *mut u8, layout: Layout) {
        CALLS.set(CALLS.get() + 1);
        // SAFETY: as the caller promises.
        unsafe { System.dealloc(pointer, layout) }
    }
}

#[global_allocator]
static ALLOCATOR: Counting = Counting;

const TIMEOUT: Duration = Duration::from_secs(20);

/// Publishes as a control loop does, and checks that this thread has not been at the allocator.
fn publish(publisher: &mut Publisher, encoder: &mut Encoder<200>, values: &[f64; 200]) -> PublishOutcome {
    let before = CALLS.get();
    let message = encoder.encode(values);
    let outcome = publisher.publish(message);
    let decoded = decode::<200>(message);
    assert_eq!(CALLS.get(), before, "{outcome:?}");
    assert_eq!(decoded.as_ref(), Ok(values));
    outcome
}

#[test]
fn a_control_loop_never_goes_to_the_allocator() {
    let address = Ipv4Addr::LOCALHOST;
    let listener = TcpListener::bind((address, 0)).unwrap();
    let master = Master::start(listener, Notices::ignored()).unwrap();
    let plant = Node::start(NodeConfig::new("/plant", address, &master.uri())).unwrap();
    let mut publisher = plant.advertise("/state", MESSAGE_TYPE).unwrap();
    let (mut encoder, values) = (Encoder::new(["x_m"; 200]), [1.5; 200]);
    for _ in 0..3 {
        let name = "/controller";
        let controller = Node::start(NodeConfig::new(name, address, &master.uri())).unwrap();
        // A subscriber that stops reading, so that its socket fills.
        let (release, held) = std::sync::mpsc::channel::<()>();
        let hang = move |_: &[u8]| held.recv().unwrap_or_default();
        let subscription = controller.subscribe("/state", MESSAGE_TYPE, hang).unwrap();
        publisher.subscribers().wait_for(1, TIMEOUT).unwrap();
        let mut sent = 0;
        while publish(&mut publisher, &mut encoder, &values).dropped == 0 {
            sent += 1;
        }
        assert!(sent > 0);
        drop(release);
        drop(subscription);
        controller.shutdown();
        while publisher.subscribers().count() > 0 {
            publish(&mut publisher, &mut encoder, &values);
        }
        while publish(&mut publisher, &mut encoder, &values) != PublishOutcome::default() {}
    }
    plant.shutdown();
    master.stop();
}
