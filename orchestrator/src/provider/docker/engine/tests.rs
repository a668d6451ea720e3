use bollard::query_parameters::LogsOptionsBuilder;
use futures_util::StreamExt as _;

use super::{super::transport::tests::Hostile, error::how_to_reach, *};

#[rstest::rstest]
#[case("1.41", Some((1, 41)))]
#[case("1.9", Some((1, 9)))]
#[case("", None)]
fn versions_are_compared_as_numbers(#[case] text: &str, #[case] version: Option<(u32, u32)>) {
    assert_eq!(parse_api(text), version);
}

#[tokio::test]
async fn an_engine_that_is_not_there_is_unreachable_with_a_fix() {
    let nowhere = tempfile::tempdir().unwrap();
    let address = format!("unix://{}/docker.sock", nowhere.path().display());
    let error = transport::connect(&address, &Exceeded::default())
        .unwrap()
        .version()
        .await
        .unwrap_err();
    assert!(how_to_reach(&address, &error).starts_with("install Docker Engine"));

    // One that listens and does not answer is installed.
    let silent = how_to_reach(&address, &Error::RequestTimeoutError);
    assert!(silent.contains("does not answer"), "{silent}");

    // A socket nobody listens on, as an engine leaves it that was killed.
    drop(std::os::unix::net::UnixListener::bind(nowhere.path().join("docker.sock")).unwrap());
    let api = transport::connect(&address, &Exceeded::default()).unwrap();
    let error = api.negotiate_version().await.unwrap_err();
    assert!(
        how_to_reach(&address, &error).starts_with("the engine has ended"),
        "{error:?}"
    );
}

#[tokio::test]
async fn an_engine_that_says_what_it_is_without_end_is_unreachable_and_that_is_why() {
    let hostile = Hostile::saying("HTTP/1.1 200 OK\r\n\r\n{\"Version\": \"", &[b'1'; 65536]);
    let error = Engine::at(&hostile.address()).await.unwrap_err();
    let why = record::causes::with_causes(&error);
    assert!(why.contains("longer than 8 MiB"), "{why}");
}

#[tokio::test]
async fn an_engine_that_takes_a_connection_and_says_nothing_is_given_up_when_its_time_is_over() {
    let hostile = Hostile::saying("", b"");
    let timeout = Duration::from_millis(200);
    let error = Engine::answering_within(timeout, &hostile.address())
        .await
        .unwrap_err();
    let why = record::causes::with_causes(&error);
    assert!(why.contains("did not answer within 200ms"), "{why}");
    assert!(error.hint().unwrap().contains("does not answer"), "{error:?}");
    assert_eq!(
        FIRST_ANSWER,
        Duration::from_secs(15),
        "what docs/security.md promises"
    );
}

#[tokio::test]
async fn a_log_whose_frame_has_no_end_is_no_lost_connection() {
    let hostile = Hostile::saying("HTTP/1.1 200 OK\r\n\r\n", b"\x01\0\0\0\x7f\xff\xff\xff0123456789");
    let (go, kernel) = OURS;
    let engine = Engine {
        address: hostile.address(),
        ..engine("1.41", "linux", go, kernel)
    };
    let (api, _) = engine.to_follow().unwrap();
    let options = LogsOptionsBuilder::default().follow(true).stdout(true).build();
    let frame = api.logs("x", Some(options)).next().await.unwrap();
    let error = translate("following the workload's lines", frame.unwrap_err());
    assert!(error.is_passing(), "as bollard tells it: {error:?}");
    let error = engine.after(&mut Backoff::default(), error).unwrap_err();
    assert!(error.to_string().contains("longer than 4 MiB"), "{error}");
}

#[test]
fn an_answer_without_end_is_not_asked_for_again() {
    let too_long = Error::from(io::Error::other(transport::tests::too_long()));
    let error = translate("listing what is ours", too_long);
    assert!(!error.is_passing(), "{error:?}");
    assert!(
        error
            .to_string()
            .contains("longer than 8 MiB, listing what is ours"),
        "{error}"
    );
}

fn engine(api: &str, os: &str, architecture: &str, kernel_machine: &str) -> Engine {
    Engine {
        api: transport::connect("http://127.0.0.1:1", &Exceeded::default()).unwrap(),
        address: "http://127.0.0.1:1".to_owned(),
        exceeded: Exceeded::default(),
        version: "20.10.24".to_owned(),
        api_version: api.to_owned(),
        os: os.to_owned(),
        architecture: architecture.to_owned(),
        kernel: String::new(),
        kernel_machine: kernel_machine.to_owned(),
        memory: None,
        parts: EngineParts::default(),
        is_here: false,
        forward: None,
        workload: Arc::default(),
    }
}

/// In Go's words, and the kernel's.
const OURS: (&str, &str) = if cfg!(target_arch = "x86_64") {
    ("amd64", "x86_64")
} else {
    ("arm64", "aarch64")
};

#[test]
fn an_engine_that_cannot_run_the_workload_is_unavailable() {
    let (go, kernel) = OURS;
    let able = engine("1.41", "linux", go, kernel);
    assert!(matches!(able.judge(), Ok(Availability::Available { .. })));
    assert_eq!(able.workload().unwrap().sha256, workload_binary::sha256());
    for (engine, why, has_fix) in [
        (engine("1.40", "linux", go, kernel), "too old", true),
        (engine("1.41", "windows", go, kernel), "windows containers", true),
        (engine("1.41", "linux", "s390x", "s390x"), "s390x", false),
        (
            engine("1.41", "linux", "386", kernel),
            "a program for i686 on a kernel for",
            true,
        ),
        (
            engine("1.41", "linux", go, "riscv64"),
            "on a kernel for riscv64",
            true,
        ),
    ] {
        let Availability::Unavailable { reason, fix } =
            engine.judge().unwrap_or_else(Availability::prevented_by)
        else {
            panic!("available: {why}");
        };
        assert!(reason.contains(why), "{reason}");
        assert_eq!(fix.is_some(), has_fix, "{reason}");
    }
}

#[test]
fn an_engine_of_another_machine_needs_the_workload_that_was_built_for_it() {
    // The builder makes it beside the programs of a user, not beside tests.
    let error = engine("1.41", "linux", "386", "i686")
        .workload()
        .map(drop)
        .unwrap_err();
    assert!(error.to_string().contains("no workload for i686"), "{error}");
    assert!(error.hint().unwrap().contains("workload/builder/build i686"));
}
