//! The ways to have the network, and what one is found to do. The main types are [`Way`] and [`Measured`].

use std::path::Path;

use serde_json::Value;
use tests::virtual_time;

/// How many round trips are sent, one every 10 ms.
const PINGS: usize = 6000;
/// How many pairs, one every 10 ms.
const PAIRS: usize = 6000;
const TCP_SECONDS: usize = 60;
const FLOOD_SECONDS: usize = 3;

/// A backend with settings of its own, and what has to be started for it.
pub struct Way {
    pub name: &'static str,
    settings: &'static str,
    before: &'static str,
}

/// In the first 10 s of a machine's life Open vSwitch 3.1 counts no processors, starts no thread for packets without a flow
/// (`Overriding n-handler-threads to 0` in its log), and a bridge of that time never carries any.
const OPEN_VSWITCH: &str = "ip link set lo up
until [ $(cut -d. -f1 /proc/uptime) -gt 10 ]; do sleep 1; done
echo 'network_probe: Open vSwitch starts'
/usr/share/openvswitch/scripts/ovs-ctl start --system-id=random >/dev/null";

/// All ways. The first is what the others are compared with.
pub const WAYS: [Way; 4] = [
    Way {
        name: "kernel",
        settings: r#"{"network": {"backend": "kernel"}}"#,
        before: "",
    },
    Way {
        name: "kernel-without-offloads",
        settings: r#"{"network": {"backend": "kernel", "offloads": "none"}}"#,
        before: "",
    },
    Way {
        name: "userspace",
        settings: r#"{"network": {"backend": "userspace"}}"#,
        before: "modprobe tun",
    },
    Way {
        name: "mininet",
        settings: r#"{"network": {"backend": "mininet"}}"#,
        before: OPEN_VSWITCH,
    },
];

/// What one way did between `sta1` and `sta2`.
pub struct Measured {
    pub name: &'static str,
    pub round_trip_ms: Vec<f64>,
    pub there_ms: Vec<f64>,
    pub back_ms: Vec<f64>,
    /// Packets lost on either way, and of how many.
    pub lost: (usize, usize),
    /// Pairs whose second packet came first, and of how many that came whole.
    pub swapped: (usize, usize),
    /// From the sending of a pair's first to that of its second.
    pub gap_us: f64,
    /// Of each second.
    pub tcp_mbit: Vec<f64>,
    pub flood_mbit: f64,
}

impl Way {
    /// Boots a machine in virtual time and measures there with `network_probe`; every step is told as it is done.
    pub fn measure(&self, probe: &Path, tell: &(dyn Fn(&str) + Sync)) -> Measured {
        tell("the guest boots");
        let script = format!(
            "{}\n./network_probe '{}' --pings {PINGS} --pairs {PAIRS} --tcp-seconds {TCP_SECONDS} \
             --flood-seconds {FLOOD_SECONDS} >$RESULT",
            self.before, self.settings
        );
        let result = virtual_time::follow(&[probe], &script, &mut |line| {
            if let Some(step) = line.strip_prefix("network_probe: ") {
                tell(step);
            }
        });
        self.read(&serde_json::from_str(result.trim()).expect("the probe prints JSON"))
    }

    fn read(&self, found: &Value) -> Measured {
        let numbers = |list: &Value, unit: f64| -> Vec<f64> {
            let list = list.as_array().expect("a list");
            list.iter().filter_map(Value::as_f64).map(|n| n / unit).collect()
        };
        let number = |number: &Value| number.as_f64().expect("a number");
        let count = |number: &Value| usize::try_from(number.as_u64().expect("a count")).expect("it fits");
        let (pings, pairs) = (&found["pings"], &found["pairs"]);
        let there_ms = numbers(&pings["there_ns"], 1e6);
        let back_ms = numbers(&pings["back_ns"], 1e6);
        assert!(!back_ms.is_empty(), "{}: no packet came back", self.name);
        Measured {
            name: self.name,
            round_trip_ms: numbers(&pings["round_trip_ns"], 1e6),
            lost: (PINGS - back_ms.len(), PINGS + there_ms.len()),
            there_ms,
            back_ms,
            swapped: (count(&pairs["swapped"]), count(&pairs["whole"])),
            gap_us: number(&pairs["gap_ns"]) / 1e3,
            tcp_mbit: numbers(&found["tcp_bits_per_second"], 1e6),
            flood_mbit: number(&found["flood_bits_per_second"]) / 1e6,
        }
    }
}
