//! What the system knows of this process, read when it is asked for, under the names that Prometheus' own clients use.
//!
//! **Source**: proc(5): `/proc/self/stat` (fields 14, 15, 20, 22), `/proc/self/status`, `/proc/self/limits`, `/proc/stat`
//! (`btime`).

use prometheus_client::collector::Collector;
use prometheus_client::encoding::{DescriptorEncoder, EncodeMetric};
use prometheus_client::metrics::counter::ConstCounter;
use prometheus_client::metrics::gauge::ConstGauge;
use std::fmt;
use std::fs;
use tikv_jemalloc_ctl::{epoch, stats};

/// Clock ticks of `/proc/self/stat` in a second: `USER_HZ`, which is 100 at the kernel's border whatever runs behind it.
const TICKS_PER_SECOND: f64 = 100.0;

/// Reads `/proc`; where there is none, nothing is told.
#[derive(Debug)]
pub(super) struct Process {
    /// Since the Unix epoch, seconds.
    start_s: Option<f64>,
}

/// Of `/proc/self/stat`.
#[derive(Debug, Clone, Copy, PartialEq)]
struct Stat {
    cpu_ticks: u64,
    threads: u64,
    start_ticks: u64,
}

impl Process {
    pub(super) fn new() -> Self {
        let started = || {
            let boot_s: f64 =
                fs::read_to_string("/proc/stat").ok()?.lines().find_map(|l| l.strip_prefix("btime "))?.parse().ok()?;
            Some(boot_s + stat()?.start_ticks as f64 / TICKS_PER_SECOND)
        };
        Self { start_s: started() }
    }
}

impl Collector for Process {
    fn encode(&self, mut encoder: DescriptorEncoder) -> Result<(), fmt::Error> {
        let mut build = encoder.encode_descriptor(
            "percept_build_info",
            "What runs, 1",
            None,
            prometheus_client::metrics::MetricType::Gauge,
        )?;
        let labels = [("version", env!("CARGO_PKG_VERSION")), ("commit", super::COMMIT)];
        ConstGauge::new(1_i64).encode(build.encode_family(&labels)?)?;
        let mut gauge = |name: &str, help: &str, value: f64| {
            let gauge = ConstGauge::new(value);
            gauge.encode(encoder.encode_descriptor(name, help, None, gauge.metric_type())?)
        };
        if let Some(start_s) = self.start_s {
            gauge("process_start_time_seconds", "When the process began, since the Unix epoch", start_s)?;
        }
        if let Some(open) = open_files() {
            gauge("process_open_fds", "Open file descriptors", open as f64)?;
        }
        if let Some(most) = fs::read_to_string("/proc/self/limits").ok().and_then(|text| max_files(&text)) {
            gauge("process_max_fds", "Most file descriptors that may be open", most as f64)?;
        }
        if let Some(resident) = fs::read_to_string("/proc/self/status").ok().and_then(|text| resident_bytes(&text)) {
            gauge("process_resident_memory_bytes", "Resident memory", resident as f64)?;
        }
        if let Some(allocated) = allocated_bytes() {
            let help = "Memory that is in use; what is resident beyond it, the allocator keeps for the next";
            gauge("percept_allocated_memory_bytes", help, allocated as f64)?;
        }
        let Some(stat) = stat() else { return Ok(()) };
        gauge("process_threads", "Threads", stat.threads as f64)?;
        let cpu = ConstCounter::new(stat.cpu_ticks as f64 / TICKS_PER_SECOND);
        let help = "Processor time, of user and system";
        // The encoder writes `_total` after it.
        cpu.encode(encoder.encode_descriptor("process_cpu_seconds", help, None, cpu.metric_type())?)
    }
}

fn stat() -> Option<Stat> {
    parse_stat(&fs::read_to_string("/proc/self/stat").ok()?)
}

fn parse_stat(text: &str) -> Option<Stat> {
    // The name stands in brackets and may hold any; what follows begins with field 3.
    let fields: Vec<&str> = text.rsplit_once(')')?.1.split_whitespace().collect();
    let field = |n: usize| fields.get(n - 3)?.parse::<u64>().ok();
    Some(Stat { cpu_ticks: field(14)? + field(15)?, threads: field(20)?, start_ticks: field(22)? })
}

fn open_files() -> Option<usize> {
    // Reading the directory opens one itself.
    Some(fs::read_dir("/proc/self/fd").ok()?.count().saturating_sub(1))
}

fn resident_bytes(status: &str) -> Option<u64> {
    let kib = status.lines().find_map(|l| l.strip_prefix("VmRSS:"))?.split_whitespace().next()?;
    kib.parse::<u64>().ok()?.checked_mul(1024)
}

fn allocated_bytes() -> Option<usize> {
    // The statistics are those of the last epoch.
    epoch::advance().ok()?;
    stats::allocated::read().ok()
}

fn max_files(limits: &str) -> Option<u64> {
    limits.lines().find_map(|l| l.strip_prefix("Max open files"))?.split_whitespace().next()?.parse().ok()
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_name_with_brackets_and_spaces_shifts_nothing() {
        let text = "42 (a) b (c) S 1 2 3 4 5 6 7 8 9 10 100 20 0 0 20 0 7 0 5000 123456 789 18446744073709551615";
        let expected = Stat { cpu_ticks: 120, threads: 7, start_ticks: 5000 };
        assert_eq!(parse_stat(text), Some(expected));
        assert_eq!(parse_stat("42 (a) S 1"), None);
    }

    #[test]
    fn resident_memory_is_told_in_kib() {
        assert_eq!(resident_bytes("VmHWM:\t  9000 kB\nVmRSS:\t    1234 kB\n"), Some(1234 * 1024));
    }

    #[test]
    fn the_limit_of_files_is_the_soft_one() {
        let text = "Limit                     Soft Limit           Hard Limit           Units\n\
                    Max open files            1024                 524288               files\n";
        assert_eq!(max_files(text), Some(1024));
    }
}
