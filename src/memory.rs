//! Memory that is available to this process, as the operating system tells it.

/// Memory available to a process in bytes, and what limits it.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct AvailableMemory {
    /// Bytes available.
    pub bytes: f64,
    /// What limits them.
    pub bound: &'static str,
}

impl AvailableMemory {
    /// The minimum of free memory, address space and control group; `None` where the operating
    /// system tells none of them.
    pub fn now() -> Option<Self> {
        let all = [
            (free_memory(), "of memory"),
            (address_space(), "of address space (ulimit -v)"),
            (control_group(), "in the memory limit of the control group"),
        ];
        let known =
            all.into_iter().filter_map(|(bytes, bound)| Some(Self { bytes: bytes?, bound }));
        known.min_by(|a, b| a.bytes.total_cmp(&b.bytes))
    }
}

/// The number after a key, in a file of the operating system.
fn number_in(file: &str, key: &str) -> Option<f64> {
    let text = std::fs::read_to_string(file).ok()?;
    let line = text.lines().find(|line| line.starts_with(key))?;
    line[key.len()..].split_whitespace().next()?.parse().ok()
}

fn free_memory() -> Option<f64> {
    number_in("/proc/meminfo", "MemAvailable:").map(|kilobytes| 1024.0 * kilobytes)
}

/// What remains of the limit on the address space.
fn address_space() -> Option<f64> {
    let limit = number_in("/proc/self/limits", "Max address space")?;
    let taken = number_in("/proc/self/status", "VmSize:")?;
    Some((limit - 1024.0 * taken).max(0.0))
}

/// What remains of the tightest limit of a control group, version 2 or 1.
fn control_group() -> Option<f64> {
    let groups = std::fs::read_to_string("/proc/self/cgroup").ok()?;
    let rooms = groups.lines().filter_map(|line| {
        let (controllers, path) = line.split_once(':')?.1.split_once(':')?;
        let (root, limit, used) = match controllers {
            "" => ("/sys/fs/cgroup", "memory.max", "memory.current"),
            "memory" => ("/sys/fs/cgroup/memory", "memory.limit_in_bytes", "memory.usage_in_bytes"),
            _ => return None,
        };
        let folder = std::path::Path::new(root).join(path.trim_start_matches('/'));
        let above = folder.ancestors().take_while(|folder| folder.starts_with(root));
        let room = |folder: &std::path::Path| {
            let number = |name: &str| number_in(folder.join(name).to_str()?, "");
            Some((number(limit)? - number(used)? + reclaimable(folder)).max(0.0))
        };
        above.filter_map(room).min_by(f64::total_cmp)
    });
    rooms.min_by(f64::total_cmp)
}

/// Bytes of file cache in a control group, which are freed on demand.
fn reclaimable(folder: &std::path::Path) -> f64 {
    let stat = folder.join("memory.stat");
    let files = |key: &str| number_in(stat.to_str()?, key);
    files("total_inactive_file ").or_else(|| files("inactive_file ")).unwrap_or(0.0)
}
