//! The networks that need a kernel of their own choice, in the guest: for real, with real netem.

use serde_json::{Value, json};
use tests::{Guest, virtual_time, workload_binary, workload_example};

/// Windows of two periods; small enough that the ball stays on the plate.
fn settings(backend: &str) -> String {
    json!({
        "dynamics": "robust", "windows": 2, "window": "4s", "period": "2s", "reference": {"amplitude_m": 0.05},
        "network": {"backend": backend},
    })
    .to_string()
}

/// The least and greatest count that a binomial variable has with a chance of one in a million beyond either.
fn binomial_interval(n: u64, p: f64) -> std::ops::RangeInclusive<u64> {
    const BEYOND: f64 = 1e-6;
    let mut logs = vec![n as f64 * (1.0 - p).ln()];
    for k in 0..n {
        let step = ((n - k) as f64 / (k + 1) as f64).ln() + (p / (1.0 - p)).ln();
        logs.push(logs[logs.len() - 1] + step);
    }
    let chance = |k: u64| logs[usize::try_from(k).unwrap()].exp();
    quantile(0..=n, chance, BEYOND)..=quantile((0..=n).rev(), chance, BEYOND)
}

/// The first value whose chance, with those before it, is more than `beyond`.
fn quantile(mut order: impl Iterator<Item = u64>, chance: impl Fn(u64) -> f64, beyond: f64) -> u64 {
    let mut sum = 0.0;
    order
        .find(|k| {
            sum += chance(*k);
            sum > beyond
        })
        .unwrap()
}

#[test]
fn the_interval_of_a_binomial_is_exact() {
    // Summed independently, by Python's lgamma.
    assert_eq!(binomial_interval(3000, 0.0199), 27..=99);
    assert_eq!(binomial_interval(10, 0.5), 0..=10);
}

fn mean_ms(times_ns: &Value) -> f64 {
    let times: Vec<f64> = times_ns
        .as_array()
        .unwrap()
        .iter()
        .map(|t| t.as_f64().unwrap())
        .collect();
    times.iter().sum::<f64>() / times.len() as f64 / 1e6
}

/// In virtual time: what the kernels and programs do, whatever else this machine does.
#[test]
fn the_kernel_network_delays_and_loses_as_the_paper_asks_and_the_userspace_one_is_a_stand_in() {
    const PINGS: u64 = 3000;
    let result = virtual_time::run(
        &[&workload_example("network_probe")],
        "modprobe tun\n\
         for backend in kernel userspace; do\n\
         ./network_probe \"{\\\"network\\\": {\\\"backend\\\": \\\"$backend\\\"}}\" --pings 3000 --pairs 2000 >$RESULT\n\
         done",
    );
    let found: Vec<Value> = result
        .lines()
        .map(|line| serde_json::from_str(line).unwrap_or_else(|error| panic!("{error}: {line}")))
        .collect();
    assert_eq!(found.len(), 2, "{result}");
    let round_trips: Vec<f64> = found
        .iter()
        .map(|found| mean_ms(&found["pings"]["round_trip_ns"]))
        .collect();
    for (found, round_trip_ms) in found.iter().zip(&round_trips) {
        // The mean of 3000 varies by 0.02 ms; the rest is what the kernel and the programs take.
        assert!((round_trip_ms - 40.0).abs() < 0.2, "{round_trip_ms} ms");
        let count = |times: &str| found["pings"][times].as_array().unwrap().len() as u64;
        let (there, back) = (count("there_ns"), count("back_ns"));
        for (sent, came) in [(PINGS, there), (there, back)] {
            let expected = binomial_interval(sent, 0.0199);
            assert!(
                expected.contains(&(sent - came)),
                "{} of {sent} lost, not {expected:?}",
                sent - came
            );
        }
        let swapped = found["pairs"]["swapped"].as_u64().unwrap();
        assert!(
            swapped > 0,
            "netem's queue sorts by send time: {:#}",
            found["pairs"]
        );
    }
    assert!((round_trips[0] - round_trips[1]).abs() < 0.2, "{round_trips:?}");

    let kernel = &found[0];
    let transcript = kernel["transcript"].as_str().unwrap();
    for words in [
        "# tc qdisc add dev sta1-eth0 root handle 5:0 htb default 1",
        "# tc class add dev s1-eth3 parent 5:0 classid 5:1 htb rate 10.000000Mbit burst 15k",
        "netem 10: parent 5:1 limit 1000 delay 10ms  1ms loss 1%",
    ] {
        assert!(transcript.contains(words), "{words} is missing in\n{transcript}");
    }
    let up = &kernel["links"][1]["up"];
    assert_eq!(up["offered"], PINGS + 2 * 2000, "{up}");
    assert_eq!(up["lateness_max_of_run_ns"], Value::Null, "{up}");
}

/// docs/twin.md has the same at length, on more links.
#[test]
fn messages_over_the_kernels_tcp_and_netem_are_as_old_as_in_the_simulation() {
    const UNLIKELY: f64 = 1e-6;
    // The last one is simulated with 3 ms more than the guest takes, which has to be found.
    let calls = [
        "--stack-us 30",
        "--stack-us 30 --nodelay",
        "--stack-us 3030 --nodelay",
    ];
    let ages = |options: &&str| {
        format!(
            "./message_ages '{{\"network\": {{\"backend\": \"kernel\"}}}}' --seconds 65 --times 4 {options} >$RESULT\n"
        )
    };
    let script: String = calls.iter().map(ages).collect();
    let result = virtual_time::run(&[&workload_example("message_ages")], &script);
    let found: Vec<Value> = result
        .lines()
        .map(|line| serde_json::from_str(line).unwrap_or_else(|error| panic!("{error}: {line}")))
        .collect();
    let [nagle, without, apart] = &found[..] else {
        panic!("{result}");
    };
    for like in [nagle, without] {
        assert!(like["p"].as_f64().unwrap() > UNLIKELY, "{like:#}");
        assert!(like["compared"][0].as_u64().unwrap() > 900, "{like:#}");
    }
    assert!(apart["p"].as_f64().unwrap() < UNLIKELY, "{apart:#}");
    // Where messages wait for acknowledgements, some are a retransmission late.
    let older_than_200_ms = |found: &Value| found["measured"]["older"][2].as_f64().unwrap();
    assert!(
        older_than_200_ms(nagle) > 10.0 * older_than_200_ms(without),
        "{result}"
    );
}

#[test]
fn a_workload_on_the_kernel_network_measures_its_windows_and_leaves_nothing_behind_when_killed() {
    let guest = Guest::boot();
    guest.put(workload_binary(), "/root/workload");
    let check = || -> Value {
        let said = guest.expect(&["/root/workload", "check", "--settings", &settings("kernel")]);
        serde_json::from_str::<Value>(&said).unwrap()["checks"][0].clone()
    };
    assert_eq!(check()["available"], true);
    what_is_missing_is_said_before_the_run(&guest, &check);

    let before = guest.expect(&["ip", "-brief", "link"]);
    let ran = guest.run(&[
        "/root/workload",
        "run",
        "--environment",
        "e-1",
        "--settings",
        &settings("kernel"),
        "--data",
        "/root/data",
        "--windows",
        "1,2",
    ]);
    assert_eq!(ran.code, Some(0), "{ran:?}");
    for window in [1, 2] {
        let record: Value =
            serde_json::from_str(&guest.expect(&["cat", &format!("/root/data/window-{window}/window.json")]))
                .unwrap();
        assert_eq!(record["complete"], true, "{record:#}");
        assert_eq!(record["network_seed"], Value::Null, "{record:#}");
        let plant_to_switch = &record["links"][2]["up"];
        assert!(plant_to_switch["offered"].as_u64().unwrap() >= 200, "{record:#}");
        assert_eq!(plant_to_switch["overflowed"], Value::Null, "{record:#}");
    }
    let transcript = guest.expect(&["cat", "/root/data/network.txt"]);
    assert!(
        transcript.contains("# tc -s qdisc show dev s1-eth3"),
        "{transcript}"
    );

    guest.expect(&[
        "sh",
        "-c",
        "setsid /root/workload run --environment e-2 --settings \"$0\" --data /root/killed --windows 1 \
         </dev/null >/root/lines 2>&1 & echo $! >/root/pid",
        &settings("kernel"),
    ]);
    until(&guest, "grep -q connected /root/lines");
    assert_ne!(used(&guest), "0", "a link is up");
    guest.expect(&["sh", "-c", "kill -9 $(cat /root/pid)"]);
    until(&guest, "test $(cat /sys/module/sch_netem/refcnt) = 0");
    assert_eq!(guest.expect(&["ip", "-brief", "link"]), before);
    assert_eq!(guest.expect(&["ip", "netns"]), "");
    assert_eq!(guest.expect(&["sh", "-c", "lsns -t net -n | wc -l"]).trim(), "1");
}

/// How many queues of netem there are.
fn used(guest: &Guest) -> String {
    guest
        .expect(&["cat", "/sys/module/sch_netem/refcnt"])
        .trim()
        .to_owned()
}

/// A tool and then the module are moved out of the way.
fn what_is_missing_is_said_before_the_run(guest: &Guest, check: &dyn Fn() -> Value) {
    guest.expect(&["mv", "/usr/sbin/tc", "/root/tc"]);
    let without_tc = check();
    guest.expect(&["mv", "/root/tc", "/usr/sbin/tc"]);
    assert_eq!(without_tc["reason"], "tc is not installed");
    assert!(
        without_tc["fix"]
            .as_str()
            .unwrap()
            .contains("apt-get install iproute2"),
        "{without_tc}"
    );

    until(guest, "modprobe -r sch_netem");
    guest.expect(&[
        "sh",
        "-c",
        "echo 'install sch_netem /bin/false' >/etc/modprobe.d/no-netem.conf",
    ]);
    let without_netem = check();
    guest.expect(&["rm", "/etc/modprobe.d/no-netem.conf"]);
    assert_eq!(without_netem["reason"], "netem is not in this kernel");
    let fix = without_netem["fix"].as_str().unwrap();
    assert!(
        fix.contains("backend: userspace") && fix.contains("sch_netem"),
        "{fix}"
    );
}

/// Waits until a shell command of the guest succeeds.
fn until(guest: &Guest, command: &str) {
    let looped = format!("until {command}; do sleep 0.1; done");
    let ran = guest.run(&["timeout", "120", "sh", "-c", &looped]);
    assert_eq!(ran.code, Some(0), "{command} does not come true: {ran:?}");
}
