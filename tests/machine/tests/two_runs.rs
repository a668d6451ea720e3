//! Two runs on one machine take turns.

use tests::Workplace;

#[test]
fn the_second_run_says_who_holds_the_machine_and_waits_for_it() {
    let first = Workplace::measuring();
    let second = first.beside();
    for workplace in [&first, &second] {
        workplace.write(
            "m.yaml",
            "matrix:\n  virtualization: [native]\nworkload:\n  windows: 1\n  window: 3s\n  period: 1s\n",
        );
    }
    let mut running = first.start(&["run", "m.yaml"]);
    running.wait_for("measuring window 1");
    let mut waiting = second.start(&["run", "m.yaml"]);
    waiting.wait_for("waiting, held by process");
    assert_eq!(running.end().code, Some(0));
    assert_eq!(waiting.end().code, Some(0));
}
