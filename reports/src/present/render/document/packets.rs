//! The part of `report.json` that is of the packets.

use serde::Serialize;

use super::EstimateEntry;

/// The packets of a scenario's windows.
#[derive(Serialize)]
#[cfg_attr(feature = "schema", derive(schemars::JsonSchema))]
pub struct ScenarioPackets<'a> {
    /// The scenario's letter.
    pub id: &'a str,
    /// The windows whose captures could be read.
    pub windows: Vec<WindowPackets>,
    /// The windows whose captures cannot be used.
    pub unreadable: Vec<UnreadableCapture<'a>>,
}

/// The packets of a window.
#[derive(Serialize)]
#[cfg_attr(feature = "schema", derive(schemars::JsonSchema))]
pub struct WindowPackets {
    /// Its number, from 1.
    pub window: u32,
    /// Packets that the kernel dropped before they were captured, at both hosts.
    pub dropped: u64,
    /// Both directions.
    pub directions: Vec<DirectionPackets>,
}

/// A window whose captures cannot be used.
#[derive(Serialize)]
#[cfg_attr(feature = "schema", derive(schemars::JsonSchema))]
pub struct UnreadableCapture<'a> {
    /// Its number, from 1.
    pub window: u32,
    /// Why not.
    pub reason: &'a str,
}

/// The packets of a window in one direction.
#[derive(Serialize)]
#[cfg_attr(feature = "schema", derive(schemars::JsonSchema))]
pub struct DirectionPackets {
    /// `state` (plant to controller) or `command` (back).
    pub topic: &'static str,
    /// Packets that left.
    pub sent: u64,
    /// Retransmitted packets: those that carried data sent before.
    pub retransmitted: u64,
    /// Packets that did not arrive.
    pub lost: u64,
    /// Reordered packets: those that arrived after one that was sent later.
    pub reordered: u64,
    /// Packets that arrived and were not captured when they left.
    pub strays: u64,
    /// Delay from one capture to the other; null without a packet.
    pub one_way: Option<SpreadEntry>,
    /// RTT: time until acknowledged, at the sender's capture; null without a packet.
    pub rtt: Option<SpreadEntry>,
    /// Difference of the delays of neighbouring arrivals; null without two packets.
    pub jitter: Option<SpreadEntry>,
    /// Time between two arrivals; null without two packets.
    pub gap: Option<SpreadEntry>,
}

/// A distribution of times.
#[derive(Serialize)]
#[cfg_attr(feature = "schema", derive(schemars::JsonSchema))]
pub struct SpreadEntry {
    /// How many times.
    pub count: u64,
    /// Their mean, in seconds.
    pub mean_s: f64,
    /// The shortest, in seconds.
    pub min_s: f64,
    /// Their median, in seconds.
    pub median_s: f64,
    /// 99 % of them are no longer than this, in seconds.
    pub p99_s: f64,
    /// The longest, in seconds.
    pub max_s: f64,
}

/// How many window pairs were rejected by one quantity of their packets.
#[derive(Serialize)]
#[cfg_attr(feature = "schema", derive(schemars::JsonSchema))]
pub struct PacketCount<'a> {
    /// `state` (plant to controller) or `command` (back).
    pub topic: &'static str,
    /// `delay`, `rtt`, `jitter`, `gap`, `lost`, `retransmitted` or `reordered`.
    pub quantity: &'static str,
    /// Letter of the first scenario.
    pub a: &'a str,
    /// Letter of the second; the same one within a scenario.
    pub b: &'a str,
    /// Window pairs compared.
    pub pairs: usize,
    /// Those of them that were rejected.
    pub rejected: usize,
}

/// Which quantities of the packets go with the difference in error of two scenarios.
#[derive(Serialize)]
#[cfg_attr(feature = "schema", derive(schemars::JsonSchema))]
pub struct PacketExplanation<'a> {
    /// Letter of the first scenario.
    pub a: &'a str,
    /// Letter of the second.
    pub b: &'a str,
    /// Mean of the second's window means minus that of the first's.
    pub shift: f64,
    /// Every quantity that varies within windows, the largest part first.
    pub factors: Vec<FactorEntry>,
}

/// A quantity of the packets, and what part of a shift goes with it.
#[derive(Serialize)]
#[cfg_attr(feature = "schema", derive(schemars::JsonSchema))]
pub struct FactorEntry {
    /// `state` (plant to controller) or `command` (back).
    pub topic: &'static str,
    /// `delay`, `rtt`, `jitter`, `gap`, `lost`, `retransmitted` or `reordered`.
    pub quantity: &'static str,
    /// Its unit: `s` or `packets a period`.
    pub unit: &'static str,
    /// Mean of the second's window means minus that of the first's, in that unit.
    pub difference: f64,
    /// Correlation with the error within windows, -1 to 1.
    pub correlation: f64,
    /// Metres of error for one unit, within windows.
    pub slope: f64,
    /// The part of the shift that goes with the difference.
    pub part: EstimateEntry,
}
