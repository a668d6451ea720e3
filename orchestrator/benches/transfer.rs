//! What a scenario leaves, fetched over SSH by us and by `scp`, side by side: at no delay and at 20 ms there and back.
//!
//! `cargo bench --profile dev --workspace --bench transfer`: in the profile that users have. Prints medians and their
//! ratio; it is not a test and has no bound.

#![allow(clippy::unwrap_used, clippy::print_stdout)] // As in tests; and a benchmark prints.

use std::{
    fs::{self, File},
    io::{BufWriter, Read, Write},
    net::{Shutdown, TcpListener, TcpStream},
    path::Path,
    process::Command,
    sync::{Arc, mpsc},
    thread,
    time::{Duration, Instant},
};

use orchestrator::{
    host::{
        Host,
        ssh::{SshClient, SshHost, Trust},
    },
    provider::{
        Environment as _, EnvironmentRequest,
        detached::{AgentClient, ClockReading, DetachedEnvironment},
    },
};
use record::{connection::Ssh, settings::Settings};
use tests::sshd::{Sshd, user};

const ROUNDS: usize = 7;
const ENVIRONMENT: &str = "matrix-transfer";
/// As large as the paper's window at 50 steps a second, a quarter of it long.
const STEPS: u64 = 75_000;

#[tokio::main]
async fn main() {
    // What scp has spoken since OpenSSH 9.0.
    let sshd = Sshd::with("Subsystem sftp internal-sftp");
    let data = sshd
        .folder()
        .join("state/environments")
        .join(ENVIRONMENT)
        .join("data/window-1");
    fs::create_dir_all(&data).unwrap();
    let bytes = fill(&data);
    println!("{:.1} MB: a log and two captures", bytes as f64 / 1e6);
    for delay in [Duration::ZERO, Duration::from_millis(10)] {
        let port = delayed(sshd.port(), delay);
        let host = host(&sshd, port);
        let agent = Arc::new(AgentClient::new(host));
        agent.deployed().await.unwrap();
        let (mut ours, mut theirs, mut compressed) = (Vec::new(), Vec::new(), Vec::new());
        for _ in 0..ROUNDS {
            theirs.push(scp(&sshd, port, &data, &[]));
            compressed.push(scp(&sshd, port, &data, &["-C"]));
            ours.push(collect(&agent).await);
        }
        let rate = |times: Vec<Duration>| bytes as f64 / 1e6 / median(times).as_secs_f64();
        let (ours, theirs, compressed) = (rate(ours), rate(theirs), rate(compressed));
        println!(
            "\n{} ms there and back, medians of {ROUNDS}",
            2 * delay.as_millis()
        );
        println!("matrix  {ours:7.1} MB/s");
        println!("scp     {theirs:7.1} MB/s, ratio {:.2}", ours / theirs);
        println!("scp -C  {compressed:7.1} MB/s, ratio {:.2}", ours / compressed);
    }
}

/// Writes what a window has: lines of numbers, and packets that are alike but for their numbers.
fn fill(folder: &Path) -> u64 {
    let mut seed = 1_u64;
    let mut number = || {
        seed = seed.wrapping_mul(6_364_136_223_846_793_005).wrapping_add(1);
        (seed >> 33) as f64 / f64::from(1_u32 << 31)
    };
    let mut log = BufWriter::new(File::create(folder.join("control.csv")).unwrap());
    for step in 0..STEPS {
        write!(log, "{step},{}", step * 20_000_000).unwrap();
        for _ in 0..14 {
            write!(log, ",{:.12}", number()).unwrap();
        }
        writeln!(log).unwrap();
    }
    log.into_inner().unwrap();
    for name in ["sta1.pcap", "sta2.pcap"] {
        let mut capture = BufWriter::new(File::create(folder.join(name)).unwrap());
        for packet in 0..STEPS * 4 {
            capture.write_all(&packet.to_le_bytes()).unwrap();
            capture.write_all(&[0x45; 66]).unwrap();
            for _ in 0..10 {
                capture.write_all(&number().to_le_bytes()).unwrap();
            }
        }
        capture.into_inner().unwrap();
    }
    let files = fs::read_dir(folder).unwrap();
    files.map(|file| file.unwrap().metadata().unwrap().len()).sum()
}

fn host(sshd: &Sshd, port: u16) -> Arc<dyn Host> {
    let configuration = sshd.folder().join("ssh_config");
    fs::write(&configuration, "IdentityFile none\n").unwrap();
    let known_hosts = sshd.folder().join(format!("known_hosts-{port}"));
    let line = sshd.known_hosts_line("host_ed25519");
    fs::write(
        &known_hosts,
        line.replace(&sshd.port().to_string(), &port.to_string()),
    )
    .unwrap();
    let ssh = Ssh {
        address: format!("{}@127.0.0.1:{port}", user()).parse().unwrap(),
        identity: Some(sshd.identity()),
        jump: None,
        known_hosts: Some(known_hosts),
    };
    let client = SshClient {
        home: Some(sshd.folder().to_owned()),
        configuration: Some(configuration),
        ..SshClient::default()
    };
    Arc::new(SshHost::new("there", ssh, Trust::KnownHosts, client))
}

fn request() -> EnvironmentRequest {
    EnvironmentRequest {
        environment: ENVIRONMENT.to_owned(),
        run: "transfer".to_owned(),
        run_directory: "/runs/transfer".into(),
        scenario: "s".to_owned(),
        host: "there".to_owned(),
        settings: Settings::default(),
        windows: vec![1],
        files: None,
    }
}

async fn collect(agent: &Arc<AgentClient>) -> Duration {
    let into = tempfile::tempdir().unwrap();
    let (clock, _) = ClockReading::of(agent).await.unwrap();
    let facts = serde_json::Map::new();
    let mut environment = DetachedEnvironment::new(Arc::clone(agent), &request(), facts, clock, false);
    let begun = Instant::now();
    environment.collect(into.path()).await.unwrap();
    begun.elapsed()
}

fn scp(sshd: &Sshd, port: u16, data: &Path, options: &[&str]) -> Duration {
    let into = tempfile::tempdir().unwrap();
    let begun = Instant::now();
    let copied = Command::new("scp")
        .args(["-q", "-r", "-F", "/dev/null", "-o", "BatchMode=yes"])
        .args(options)
        .arg("-i")
        .arg(sshd.identity())
        .arg("-o")
        .arg(format!(
            "UserKnownHostsFile={}",
            sshd.folder().join(format!("known_hosts-{port}")).display()
        ))
        .args(["-P", &port.to_string()])
        .arg(format!("{}@127.0.0.1:{}", user(), data.display()))
        .arg(into.path())
        .output()
        .unwrap();
    assert!(copied.status.success(), "{copied:?}");
    begun.elapsed()
}

/// A port from which everything takes so long to get to another port, and back.
fn delayed(to: u16, delay: Duration) -> u16 {
    let listener = TcpListener::bind(("127.0.0.1", 0)).unwrap();
    let port = listener.local_addr().unwrap().port();
    thread::spawn(move || {
        for near in listener.incoming() {
            let near = near.unwrap();
            let far = TcpStream::connect(("127.0.0.1", to)).unwrap();
            for stream in [&near, &far] {
                stream.set_nodelay(true).unwrap();
            }
            pass(near.try_clone().unwrap(), far.try_clone().unwrap(), delay);
            pass(far, near, delay);
        }
    });
    port
}

fn pass(mut from: TcpStream, mut into: TcpStream, delay: Duration) {
    let (on_the_way, arriving) = mpsc::channel::<(Instant, Vec<u8>)>();
    thread::spawn(move || {
        let mut piece = vec![0; 256 << 10];
        while let Ok(read @ 1..) = from.read(&mut piece) {
            let sent = (Instant::now(), piece.get(..read).unwrap().to_vec());
            if on_the_way.send(sent).is_err() {
                return;
            }
        }
    });
    thread::spawn(move || {
        for (sent, piece) in arriving {
            thread::sleep((sent + delay).saturating_duration_since(Instant::now()));
            if into.write_all(&piece).is_err() {
                return;
            }
        }
        let _ = into.shutdown(Shutdown::Write);
    });
}

fn median(mut times: Vec<Duration>) -> Duration {
    times.sort();
    times.get(times.len() / 2).copied().unwrap()
}
