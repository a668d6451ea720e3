//! `kill -9` of `matrix` at every moment of a scenario on a real Docker Engine, and `resume`.

use rstest::rstest;
use tests::{
    WHOLE_WINDOWS_COUNT, Workplace,
    engine::on_the_engine,
    killed::{go_on_whole, kill_at},
};

const MATRIX: &str = "\
matrix:
  virtualization: [docker]
workload:
  windows: 2
  window: 2s
  period: 500ms
  reference: {amplitude_m: 0.05}
";

#[rstest]
#[case::creating("environment-creating")]
#[case::created("environment-created")]
#[case::measuring("workload/measuring")]
#[case::between_windows("workload/window-complete")]
#[case::collecting("workload/finished")]
#[case::collected("window-collected")]
#[case::discarding("environment-discarding")]
fn a_run_killed_on_docker_is_whole_after_resume(#[case] moment: &str) {
    let workplace = Workplace::measuring();
    workplace.write("m.yaml", format!("{MATRIX}  {WHOLE_WINDOWS_COUNT}\n"));
    kill_at(&workplace, moment);
    if moment.starts_with("workload/") {
        let there = on_the_engine(&workplace);
        assert!(!there.is_empty(), "what was killed left something behind");
    }

    go_on_whole(&workplace);

    let cleaned = workplace.run(&["clean"]);
    assert_eq!(cleaned.code, Some(0), "{cleaned:?}");
    assert_eq!(on_the_engine(&workplace), Vec::<String>::new());
}
