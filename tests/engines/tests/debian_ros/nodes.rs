//! Nodes written in rospy beside ours and in place of ours.

use rstest::rstest;

use crate::{
    authors, settings,
    stage::{Stage, machine},
};

#[rstest]
fn a_rospy_subscriber_gets_every_state(#[values("embedded", "rosmaster")] master: &str) {
    let _machine = machine();
    let mut stage = Stage::rehearse(&settings(master), &[]);
    let listener = stage.node("h1", "listener.py", &["listener"]);
    stage.wait_for_notice("/listener at 10.0.0.1:");
    let line = listener.wait_for("");
    assert_eq!(line, "received 50");
    assert_eq!(listener.wait_for("received 150"), "received 150");
    drop(listener);
    stage.wait_for_notice("left /state");
    stage.end();
}

#[rstest]
fn our_controller_steers_a_rospy_plant_and_finds_it_again_after_its_death(
    #[values("embedded", "rosmaster")] master: &str,
) {
    let _machine = machine();
    let mut stage = Stage::rehearse(&settings(master), &["plant"]);
    for _ in 0..2 {
        let plant = stage.node("sta2", "plant.py", &[]);
        stage.wait_for_notice("/plant at 10.0.0.3:");
        plant.wait_for("following");
        plant.kill();
        stage.wait_for_notice("no connection to the publisher of /state");
    }
    stage.end();
}

#[rstest]
fn a_rospy_controller_steers_our_plant_and_is_found_again_after_its_death(
    #[values("embedded", "rosmaster")] master: &str,
) {
    let _machine = machine();
    let mut stage = Stage::rehearse(&settings(master), &["controller"]);
    for _ in 0..2 {
        let controller = stage.node("sta1", "controller.py", &[]);
        stage.wait_for_notice("/controller at 10.0.0.2:");
        controller.wait_for("following");
        controller.kill();
        stage.wait_for_notice("no connection to the publisher of /command");
    }
    stage.end();
}

#[rstest]
fn our_controller_steers_a_rospy_plant_that_speaks_the_authors_texts(
    #[values("embedded", "rosmaster")] master: &str,
) {
    let _machine = machine();
    let mut stage = Stage::rehearse(&authors(master), &["plant"]);
    let plant = stage.node("sta2", "author_plant.py", &[]);
    stage.wait_for_notice("/plant at 10.0.0.3:");
    plant.wait_for("following");
    plant.kill();
    stage.wait_for_notice("no connection to the publisher of /plant_state");
    stage.end();
}

#[rstest]
fn a_rospy_controller_that_speaks_the_authors_texts_steers_our_plant(
    #[values("embedded", "rosmaster")] master: &str,
) {
    let _machine = machine();
    let mut stage = Stage::rehearse(&authors(master), &["controller"]);
    let controller = stage.node("sta1", "author_controller.py", &[]);
    stage.wait_for_notice("/controller at 10.0.0.2:");
    controller.wait_for("following");
    controller.kill();
    stage.wait_for_notice("no connection to the publisher of /control_action");
    stage.end();
}

#[test]
fn without_our_nodes_there_are_hosts_and_a_master() {
    let _machine = machine();
    let stage = Stage::rehearse(&settings("embedded"), &["plant", "controller"]);
    let plant = stage.node("sta2", "plant.py", &[]);
    let controller = stage.node("sta1", "controller.py", &[]);
    controller.wait_for("following");
    drop((plant, controller));
    stage.end();
}
