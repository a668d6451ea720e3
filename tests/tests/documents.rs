//! All that is printed for programs: each has a JSON Schema, and nothing is in the one and not in the other.

use tests::{
    Workplace,
    documents::{assert_described, schema},
};

/// Two scenarios of the fake platform that are alike, and one whose environment cannot be made; no host is a Sparc.
fn matrix_file(special: &str) -> String {
    format!(
        "matrix: {{hardware: [x86_64, sparc], os: [debian-12], virtualization: [fake], labels: {{place: [here, there, away]}}, exclude: [{{hardware: sparc, place: away}}]}}\n\
         hosts: {{desk: {{connect: local, hardware: x86_64, os: debian-12}}}}\n\
         workload: {{windows: 2, window: 8s, period: 1s}}\n\
         report: {{equivalence_margin: 1mm, family: all}}\n{special}"
    )
}

/// A workplace in which no Docker Engine is to be found.
fn workplace() -> Workplace {
    let mut workplace = Workplace::new();
    let nowhere = workplace.path().join("no-engine.sock");
    workplace.set("DOCKER_HOST", &format!("unix://{}", nowhere.display()));
    workplace
}

#[test]
fn each_schema_says_what_it_is_of_and_in_which_language() {
    let workplace = workplace();
    let refused = workplace.run(&["schema", "nothing"]);
    let (_, names) = refused.err.split_once("[possible values: ").unwrap();
    let (names, _) = names.split_once(']').unwrap();
    let names: Vec<&str> = names.split(", ").collect();
    assert!(names.len() > 10, "{names:?}");
    for name in names {
        let schema = schema(&workplace, name);
        assert_eq!(
            schema["$schema"], "https://json-schema.org/draft/2020-12/schema",
            "{name}"
        );
        assert!(schema["title"].is_string(), "{name}: {schema:#}");
        assert!(schema["description"].is_string(), "{name}: {schema:#}");
    }
}

#[test]
fn the_docs_name_each_field_of_the_reports_schema() {
    let schema = schema(&workplace(), "report");
    let docs = include_str!("../../docs/report-columns.md");
    let definitions = schema["$defs"].as_object().unwrap().values();
    let fields = definitions
        .chain([&schema])
        .filter_map(|definition| definition["properties"].as_object())
        .flat_map(|properties| properties.keys());
    let mut many = 0;
    for field in fields {
        assert!(docs.contains(&format!("`{field}`")), "no `{field}` in the docs");
        many += 1;
    }
    assert!(many > 150, "{many} fields");
}

#[test]
fn what_is_printed_for_programs_is_as_its_schema_says() {
    let workplace = workplace();
    workplace.write("m.yaml", matrix_file(""));
    let plan = workplace.json(&["plan", "m.yaml"]);
    let scenarios = plan["scenarios"].as_array().unwrap();
    let away = scenarios
        .iter()
        .find(|it| it["feasible"] == true && it["axes"]["place"] == "away")
        .unwrap_or_else(|| panic!("{plan:#}"));
    workplace.write(
        "m.yaml",
        matrix_file(&format!(
            "providers: {{fake: {{scenarios: {{{}: {{fail: {{at: create}}}}}}}}}}\n",
            away["slug"].as_str().unwrap()
        )),
    );
    let described = |name: &str, arguments: &[&str]| {
        let document = workplace.json(arguments);
        assert_described(&workplace, name, &document);
        document
    };

    let checked = described("check", &["check", "m.yaml", "--hosts"]);
    assert!(checked["infeasible"][0]["reason"].is_string(), "{checked:#}");
    assert!(
        checked["warnings"][0]["line"].is_u64(),
        "an exclude without a reason: {checked:#}"
    );
    described("plan", &["plan", "m.yaml"]);
    let with_window_sd = described("plan", &["plan", "m.yaml", "--window-sd", "1mm"]);
    assert!(with_window_sd["spread"].is_f64(), "{with_window_sd:#}");
    described("plan", &["run", "m.yaml", "--dry-run"]);

    let report = described("report", &["run", "m.yaml", "--keep", "always"]);
    for part in ["contrasts", "comparisons", "infeasible", "errored"] {
        assert!(!report[part].as_array().unwrap().is_empty(), "{part}: {report:#}");
    }
    let directory = workplace.run_directory().display().to_string();
    let run = directory.as_str();
    assert_eq!(described("report", &["report", run]), report);
    described("status", &["status", run]);
    let runs = described("runs", &["runs"]);
    assert_eq!(runs["runs"][0]["state"], "errored", "{runs:#}");
    let verified = described("status", &["status", run, "--verify"]);
    assert_eq!(verified["verified"]["checked"], true, "{verified:#}");
    let left = described("resume", &["resume", run, "--dry-run"]);
    assert_eq!(left["scenarios"][0]["slug"], away["slug"], "{left:#}");
    described("redact", &["redact", run, "--output", "blind"]);
    described("messages", &["messages", run]);
    described("calibrate", &["calibrate", run, "--repeats", "1"]);

    let cleaned = described("clean", &["clean", "--dry-run"]);
    assert!(
        !cleaned["leftovers"].as_array().unwrap().is_empty(),
        "{cleaned:#}"
    );
    assert!(
        !cleaned["not_asked"].as_array().unwrap().is_empty(),
        "{cleaned:#}"
    );
}

#[test]
fn commands_and_options_have_their_former_names_too() {
    let workplace = workplace();
    workplace.write("m.yaml", matrix_file(""));
    let of_levels = |option: &str| workplace.json(&["plan", "m.yaml", option, "1mm"])["spread"].clone();
    assert!(of_levels("--spread").is_f64());
    assert_eq!(of_levels("--spread"), of_levels("--window-sd"));

    workplace.run(&["run", "m.yaml", "--quiet"]);
    let directory = workplace.run_directory().display().to_string();
    let run = directory.as_str();
    let reported = |option: &str| workplace.json(&["report", run, option, "{place: here}"]);
    let report = reported("--control");
    assert_eq!(report["scenarios"][0]["is_control"], true, "{report:#}");
    assert_eq!(report, reported("--baseline"));
    let both = workplace.run(&["report", run, "--control", "{}", "--baseline", "{}"]);
    assert_eq!(both.code, Some(2), "{both:?}");

    let calibrated = |command: &str| workplace.json(&[command, run, "--repeats", "1"]);
    assert_eq!(calibrated("selftest"), calibrated("calibrate"));
    assert_eq!(schema(&workplace, "selftest"), schema(&workplace, "calibrate"));
    let help = workplace.run(&["--help"]).out;
    assert!(help.contains("calibrate") && !help.contains("selftest"), "{help}");
}

#[test]
fn what_was_recorded_is_reported_as_the_schema_says() {
    let workplace = workplace();
    let recorded = concat!(env!("CARGO_MANIFEST_DIR"), "/fixtures/recorded");
    let report = workplace.json(&["report", recorded, "--output", "report"]);
    for part in ["conclusions", "packets", "packet_counts", "packet_explanations"] {
        assert!(!report[part].as_array().unwrap().is_empty(), "{part}: {report:#}");
    }
    assert_described(&workplace, "report", &report);
}

#[test]
fn what_is_printed_without_a_run_is_as_its_schema_says() {
    let workplace = workplace();
    workplace.write("m.yaml", matrix_file(""));
    workplace.write("x", "1\n2\n3\n");
    workplace.write("y", "2\n3\n4\n");
    workplace.write("wrong.yaml", "matirx: {}\n");
    let calls: [(&str, &[&str]); 4] = [
        ("ks", &["ks", "x", "y"]),
        ("doctor", &["doctor", "m.yaml"]),
        ("error", &["check", "wrong.yaml"]),
        ("error", &["status", "nowhere"]),
    ];
    for (name, arguments) in calls {
        assert_described(&workplace, name, &workplace.json(arguments));
    }
}
