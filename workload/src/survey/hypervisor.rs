//! Which hypervisor can be seen from inside, if there is one. The main functions are [`is_present`] and [`name`].
//!
//! Sources: the `hypervisor` flag of proc_cpuinfo(5); leaf 0x40000000 of CPUID, where hypervisors sign (KVM:
//! Documentation/virt/kvm/x86/cpuid.rst); Documentation/ABI/stable/sysfs-hypervisor-xen; the DMI table.

// CPUID is an instruction, unsafe in some versions of the standard library and safe in others.
#![allow(unsafe_code, unused_unsafe)]

use std::path::Path;

use super::{field, read};

/// On x86 the processor says it; elsewhere only its presence can be seen.
pub fn is_present(cpu_info: &str) -> Option<bool> {
    let by_flags = field(cpu_info, "flags").map(|flags| flags.split(' ').any(|flag| flag == "hypervisor"));
    let seen = || {
        let signs = ["/sys/hypervisor/type", "/proc/device-tree/hypervisor"];
        signs.iter().any(|path| Path::new(path).exists()).then_some(true)
    };
    by_flags.or_else(seen)
}

/// What it calls itself, such as `KVMKVMKVM`, `TCGTCGTCGTCG`, `VBoxVBoxVBox`, `xen`. To be called where there is one.
pub fn name() -> Option<String> {
    signature().or_else(|| read("/sys/hypervisor/type"))
}

/// Maker and product of the machine, as its firmware says.
pub fn machine() -> Option<String> {
    let parts = ["sys_vendor", "product_name"];
    let parts: Vec<String> = parts
        .iter()
        .filter_map(|part| read(format!("/sys/class/dmi/id/{part}")))
        .collect();
    (!parts.is_empty()).then(|| parts.join(" "))
}

#[cfg(any(target_arch = "x86", target_arch = "x86_64"))]
fn signature() -> Option<String> {
    #[cfg(target_arch = "x86")]
    use std::arch::x86::__cpuid;
    #[cfg(target_arch = "x86_64")]
    use std::arch::x86_64::__cpuid;

    // SAFETY: every processor that Rust's x86 targets run on has CPUID; it touches no memory.
    let leaf = unsafe { __cpuid(0x4000_0000) };
    signature_of([leaf.ebx, leaf.ecx, leaf.edx])
}

#[cfg(not(any(target_arch = "x86", target_arch = "x86_64")))]
fn signature() -> Option<String> {
    None
}

/// Twelve characters in three registers, padded with zeros.
#[cfg_attr(not(any(target_arch = "x86", target_arch = "x86_64")), allow(dead_code))]
fn signature_of(registers: [u32; 3]) -> Option<String> {
    let bytes: Vec<u8> = registers
        .iter()
        .flat_map(|register| register.to_le_bytes())
        .collect();
    let text = String::from_utf8(bytes).ok()?;
    let text = text.trim_end_matches('\0').trim();
    let printable = !text.is_empty() && text.chars().all(|c| c.is_ascii_graphic() || c == ' ');
    printable.then(|| text.to_owned())
}

#[cfg(test)]
mod tests {
    use rstest::rstest;

    use super::*;

    #[rstest]
    #[case::inside("flags\t\t: fpu vme hypervisor lahf_lm", Some(true))]
    #[case::bare("flags\t\t: fpu vme lahf_lm", Some(false))]
    fn the_processor_says_whether_there_is_a_hypervisor(
        #[case] cpu_info: &str,
        #[case] wanted: Option<bool>,
    ) {
        assert_eq!(is_present(cpu_info), wanted);
    }

    #[rstest]
    // Documentation/virt/kvm/x86/cpuid.rst.
    #[case::kvm([0x4b4d_564b, 0x564b_4d56, 0x4d], Some("KVMKVMKVM"))]
    #[case::hyper_v([0x7263_694d, 0x666f_736f, 0x7648_2074], Some("Microsoft Hv"))]
    #[case::none([0, 0, 0], None)]
    #[case::of_another_leaf([0x1, 0x8000_0000, 0xff], None)]
    fn a_hypervisor_signs_with_twelve_characters(#[case] registers: [u32; 3], #[case] wanted: Option<&str>) {
        assert_eq!(signature_of(registers).as_deref(), wanted);
    }
}
