//! Which settings of Vagrant's providers a matrix file may set under `options`, and with what. The function is [`refusal`].
//!
//! Among the settings of a provider are some by which the host runs a program (`proxy_command`, `emulator_path`), asks another
//! machine (`uri`) or gives the guest its disks and files. So those that are harmless are listed, and all others refused. Words are
//! of letters, digits, `.`, `_`, `+` and `-`, since some plugins write them into libvirt's XML as they are.
//!
//! Sources: the README of vagrant-libvirt 0.11, Vagrant's pages on its providers, and `VBoxManage modifyvm`.

use serde_json::Value;

use self::Kind::{Customize, Flag, Whole, Word};

/// What is written behind a setting's name.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub enum Kind {
    /// `true` or `false`.
    Flag,
    /// A whole number from 0 up.
    Whole,
    /// A name such as `qemu64`.
    Word,
    /// A list of VirtualBox's commands.
    Customize,
}

/// Settings that a matrix file may set, each with what is written behind its name.
pub type Allowed = &'static [(&'static str, Kind)];

/// Of `hyperv`.
pub const HYPERV: Allowed = &[
    ("auto_start_action", Word),
    ("auto_stop_action", Word),
    ("enable_checkpoints", Flag),
    ("enable_virtualization_extensions", Flag),
    ("linked_clone", Flag),
    ("maxmemory", Whole),
];

/// Of `libvirt`.
pub const LIBVIRT: Allowed = &[
    ("autostart", Flag),
    ("clock_offset", Word),
    ("cpu_fallback", Word),
    ("cpu_mode", Word),
    ("cpu_model", Word),
    ("cpuset", Word),
    ("disk_bus", Word),
    ("driver", Word),
    ("graphics_type", Word),
    ("keymap", Word),
    ("kvm_hidden", Flag),
    ("machine_arch", Word),
    ("machine_type", Word),
    ("machine_virtual_size", Whole),
    ("nested", Flag),
    ("nic_adapter_count", Whole),
    ("nic_model_type", Word),
    ("qemu_use_session", Flag),
    ("shares", Whole),
    ("sound_type", Word),
    ("storage_pool_name", Word),
    ("suspend_mode", Word),
    ("video_accel3d", Flag),
    ("video_type", Word),
    ("video_vram", Whole),
    ("volume_cache", Word),
];

/// Of `parallels`.
pub const PARALLELS: Allowed = &[
    ("check_guest_tools", Flag),
    ("linked_clone", Flag),
    ("update_guest_tools", Flag),
];

/// Of `qemu`.
pub const QEMU: Allowed = &[
    ("arch", Word),
    ("cpu", Word),
    ("machine", Word),
    ("net_device", Word),
    ("no_daemonize", Flag),
];

/// Of `virtualbox`.
pub const VIRTUALBOX: Allowed = &[
    ("auto_nat_dns_proxy", Flag),
    ("check_guest_additions", Flag),
    ("customize", Customize),
    ("default_nic_type", Word),
    ("functional_vboxsf", Flag),
    ("gui", Flag),
    ("linked_clone", Flag),
];

/// Of `vmware_desktop`.
pub const VMWARE_DESKTOP: Allowed = &[("gui", Flag), ("linked_clone", Flag)];

/// What `modifyvm` may set of VirtualBox's machine, each to one word. Not among them: what names a file, a socket or a card of the
/// host (`--uart-mode1`, `--nic-trace-file1`, `--recording-file`, `--nic-property1`, `--bridge-adapter1`, …).
const MODIFYVM: [&str; 25] = [
    "--audio",
    "--audio-driver",
    "--chipset",
    "--cpu-execution-cap",
    "--cpuexecutioncap",
    "--graphicscontroller",
    "--hpet",
    "--hwvirtex",
    "--ioapic",
    "--large-pages",
    "--largepages",
    "--nested-hw-virt",
    "--nested-paging",
    "--nestedpaging",
    "--nic-type1",
    "--nictype1",
    "--pae",
    "--paravirt-provider",
    "--paravirtprovider",
    "--rtc-use-utc",
    "--rtcuseutc",
    "--vm-execution-engine",
    "--vram",
    "--vtx-vpid",
    "--vtxvpid",
];

/// How VirtualBox's virtual time goes; the keys beside these name devices and files.
const EXTRA_DATA: &str = "VBoxInternal/TM/";

/// What is refused and often wanted, with what does the same.
const INSTEAD: [(&[&str], &str); 4] = [
    (
        &[
            "uri",
            "system_uri",
            "host",
            "username",
            "password",
            "socket",
            "proxy_command",
            "connect_via_ssh",
        ],
        "name that machine under `hosts:` with `connect: {ssh: …}`: its own libvirt is used there",
    ),
    (
        &["emulator_path", "qemu_bin", "qemu_dir"],
        "install that emulator on the host as its own",
    ),
    (
        &["kernel", "initrd", "cmd_line", "dtb", "loader", "nvram"],
        "put it into the box: `vagrant/box/machine` makes one with a kernel of its own",
    ),
    (
        &["extra_qemu_args", "qemuargs", "qemuenv", "qemu_extra_args"],
        "take what you need of it from the settings that may be set",
    ),
];

/// Why a setting is refused.
#[derive(Debug, Clone, PartialEq, Eq)]
pub struct Refusal {
    /// What is wrong.
    pub reason: String,
    /// What to write instead.
    pub instead: String,
}

/// Why a matrix file may not set this; none if it may.
#[must_use]
pub fn refusal(allowed: Allowed, provider: &str, option: &str, value: &Value) -> Option<Refusal> {
    let Some((_, kind)) = allowed.iter().find(|(name, _)| *name == option) else {
        let known: Vec<_> = allowed.iter().map(|(name, _)| format!("`{name}`")).collect();
        let instead = INSTEAD.iter().find(|(names, _)| names.contains(&option));
        return Some(Refusal {
            reason: format!(
                "a matrix file may not set `{option}` of {provider}, by which the host could be made to do anything"
            ),
            instead: match instead {
                Some((_, instead)) => (*instead).to_owned(),
                None => format!("leave it out; what may be set is {}", known.join(", ")),
            },
        });
    };
    let wanted = match kind {
        Flag => (!value.is_boolean()).then_some("`true` or `false`"),
        Whole => (!value.is_u64()).then_some("a whole number from 0 up"),
        Word => (!value.as_str().is_some_and(is_word))
            .then_some("one word of letters, digits, `.`, `_`, `+` and `-`"),
        Customize => return refused_command(value),
    };
    wanted.map(|wanted| Refusal {
        reason: format!("`{option}` of {provider} cannot be `{value}`"),
        instead: format!("write {wanted}"),
    })
}

/// Whether it is a name and nothing else, in whatever it is written into.
#[must_use]
pub fn is_word(text: &str) -> bool {
    let plain = |byte: u8| byte.is_ascii_alphanumeric() || b"._+-".contains(&byte);
    (1..=64).contains(&text.len()) && text.bytes().all(plain)
}

fn refused_command(value: &Value) -> Option<Refusal> {
    let commands = value.as_array().map(Vec::as_slice);
    let refused = commands.map(|commands| commands.iter().find(|command| !may_be_called(command)));
    let told = match refused {
        Some(None) => return None,
        Some(Some(command)) => command,
        None => value,
    };
    Some(Refusal {
        reason: format!("a matrix file may not have VirtualBox do `{told}`"),
        instead: format!(
            "leave it out; what may be customized is `[modifyvm, ':id', SETTING, VALUE]` with one of {}, and `[setextradata, ':id', \
             {EXTRA_DATA}…, VALUE]`",
            MODIFYVM.join(", ")
        ),
    })
}

fn may_be_called(command: &Value) -> bool {
    let words = command.as_array().map(Vec::as_slice).unwrap_or_default();
    let words: Option<Vec<&str>> = words.iter().map(Value::as_str).collect();
    match words.as_deref() {
        Some(["modifyvm", ":id", setting, value]) => MODIFYVM.contains(setting) && is_word(value),
        Some(["setextradata", ":id", key, value]) => {
            key.strip_prefix(EXTRA_DATA).is_some_and(is_word) && is_word(value)
        }
        _ => false,
    }
}

#[cfg(test)]
mod tests {
    use serde_json::json;

    use super::*;

    fn refused(provider: &str, option: &str, value: &Value) -> Option<Refusal> {
        let allowed = if provider == "virtualbox" {
            VIRTUALBOX
        } else if provider == "qemu" {
            QEMU
        } else {
            LIBVIRT
        };
        refusal(allowed, provider, option, value)
    }

    #[rstest::rstest]
    #[case::driver("libvirt", "driver", json!("qemu"))]
    #[case::model("libvirt", "cpu_model", json!("qemu64"))]
    #[case::flag("virtualbox", "check_guest_additions", json!(false))]
    #[case::engine("virtualbox", "customize", json!([["modifyvm", ":id", "--vm-execution-engine", "recompiler"]]))]
    #[case::time("virtualbox", "customize", json!([["setextradata", ":id", "VBoxInternal/TM/WarpDrivePercentage", "20"]]))]
    fn what_only_says_how_the_guest_is_made_may_be_set(
        #[case] provider: &str,
        #[case] option: &str,
        #[case] value: Value,
    ) {
        assert_eq!(refused(provider, option, &value), None);
    }

    #[rstest::rstest]
    #[case::ssh("libvirt", "proxy_command", json!("sh -c 'touch /tmp/x'"))]
    #[case::uri("libvirt", "uri", json!("qemu+ext:///system?command=/tmp/x"))]
    #[case::emulator("libvirt", "emulator_path", json!("/tmp/x"))]
    #[case::of_another_provider("virtualbox", "driver", json!("qemu"))]
    #[case::arguments("qemu", "extra_qemu_args", json!(["-fsdev", "local,path=/"]))]
    #[case::xml("libvirt", "nic_model_type", json!("virtio'/><filesystem/>"))]
    #[case::no_word("libvirt", "driver", json!(["qemu"]))]
    #[case::folder("virtualbox", "customize", json!([["sharedfolder", "add", ":id", "--name", "x", "--hostpath", "/"]]))]
    #[case::file("virtualbox", "customize", json!([["modifyvm", ":id", "--uart-mode1", "file"]]))]
    #[case::disk("virtualbox", "customize", json!([["storageattach", ":id", "--medium", "/dev/sda"]]))]
    #[case::another_machine("virtualbox", "customize", json!([["modifyvm", "other", "--hpet", "on"]]))]
    #[case::device("virtualbox", "customize", json!([["setextradata", ":id", "VBoxInternal/Devices/x/Path", "y"]]))]
    #[case::one_of_many("virtualbox", "customize", json!([["modifyvm", ":id", "--hpet", "on"], ["controlvm", ":id", "x"]]))]
    #[case::no_list("virtualbox", "customize", json!("modifyvm"))]
    fn what_reaches_beyond_the_guest_is_refused(
        #[case] provider: &str,
        #[case] option: &str,
        #[case] value: Value,
    ) {
        let refusal = refused(provider, option, &value).unwrap();
        assert!(!refusal.instead.is_empty(), "{refusal:?}");
    }

    #[test]
    fn who_wants_another_machines_libvirt_is_told_how_to_name_it() {
        let refusal = refused("libvirt", "uri", &json!("qemu+ssh://lab/system")).unwrap();
        assert!(refusal.instead.contains("`connect: {ssh: …}`"), "{refusal:?}");
    }
}
