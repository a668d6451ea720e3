//! Whether a host can make machines with one of Vagrant's providers, asked of Vagrant and of the provider there. The
//! function is [`survey`].

use std::{path::Path, time::Duration};

use record::run_directory::fact;
use serde_json::{Map, Value, json};

use super::{
    VagrantSettings,
    kind::{Probe, Requirement},
    machine, output,
};
use crate::{
    host::{Exit, Host, Program, output as run},
    provider::{Availability, ProviderError},
};

const TIMEOUT: Duration = Duration::from_secs(120);
/// What a host answers when it has no such program, as shells do.
const NOT_FOUND: i32 = 127;

/// Vagrant's version on a host; none where it is not installed or does not say.
pub async fn version(host: &dyn Host) -> Option<String> {
    let printed = ask(host, &["--version"]).await.ok()??;
    Some(printed.trim().trim_start_matches("Vagrant ").to_owned())
}

/// Versions of what makes a provider's machines, by the program that it requires; none where it does not say.
pub async fn versions(host: &dyn Host, required: &Requirement) -> Map<String, Value> {
    let Some((program, arguments)) = required.probe else {
        return Map::new();
    };
    // virsh speaks the language of its surroundings.
    let english = ["LC_ALL=C", program];
    let program = Program::new("env", english.iter().chain(arguments).copied());
    match run(host, &program, b"", TIMEOUT).await {
        Ok((exit, printed)) if exit.success() => versions_in(&String::from_utf8_lossy(&printed)),
        _ => Map::new(),
    }
}

/// The versions in what `virsh version` or `VBoxManage --version` printed.
fn versions_in(printed: &str) -> Map<String, Value> {
    let version = |line: &str| {
        let (name, version) = match line.split_once(": ") {
            // By their names in small letters these are `fact::LIBVIRT` and `fact::QEMU`.
            Some(("Using library" | "Running hypervisor", named)) => named.split_once(' ')?,
            // VirtualBox prints nothing but the version, after its warnings.
            None if line.starts_with(|c: char| c.is_ascii_digit()) => (fact::VIRTUALBOX, line),
            _ => return None,
        };
        Some((name.to_lowercase(), json!(version)))
    };
    printed.lines().map(str::trim).filter_map(version).collect()
}

/// Whether machines of that provider can be made of the box.
pub async fn survey(
    host: &dyn Host,
    provider: &str,
    required: &Requirement,
    settings: &VagrantSettings,
) -> Availability {
    match look(host, provider, required, settings).await {
        Ok(availability) => availability,
        Err(error) => Availability::prevented_by(error),
    }
}

async fn look(
    host: &dyn Host,
    provider: &str,
    required: &Requirement,
    settings: &VagrantSettings,
) -> Result<Availability, ProviderError> {
    let unavailable = |reason: String, fix: &str| Availability::Unavailable {
        reason,
        fix: Some(fix.to_owned()),
    };
    // Vagrant takes seconds to say anything: what can be known without it is asked first.
    if !end_of(host, ("sh", &["-c", "command -v vagrant"]))
        .await?
        .success()
    {
        return Ok(unavailable(
            "Vagrant is not installed".to_owned(),
            "on Debian: apt-get install vagrant; elsewhere: https://developer.hashicorp.com/vagrant/install",
        ));
    }
    if let Some(probe) = required.probe {
        let exit = end_of(host, probe).await?;
        let words = exit.last_words.split_whitespace().collect::<Vec<_>>().join(" ");
        match exit.code {
            Some(0) => {}
            Some(NOT_FOUND) => {
                return Ok(unavailable(
                    format!("{provider} is not installed: there is no `{}`", probe.0),
                    required.fix,
                ));
            }
            _ => {
                return Ok(unavailable(
                    format!("{provider} does not work: {words}"),
                    required.fix,
                ));
            }
        }
    }
    if let Some(plugin) = required.plugin {
        let plugins = ask(host, &["plugin", "list"]).await?.unwrap_or_default();
        if !plugins.split_whitespace().any(|word| word == plugin) {
            return Ok(unavailable(
                format!("Vagrant has no plugin `{plugin}`"),
                required.fix,
            ));
        }
    }
    let boxes = ask(host, &["box", "list", "--machine-readable"])
        .await?
        .unwrap_or_default();
    if !has_box(&boxes, provider, settings) {
        return Ok(unavailable(
            format!("Vagrant has no box `{}` for {provider}", settings.name),
            &how_to_get(&settings.name, provider),
        ));
    }
    Ok(Availability::Available {
        detail: match version(host).await {
            Some(version) => format!("Vagrant {version}"),
            None => "Vagrant".to_owned(),
        },
    })
}

/// How the box comes to Vagrant.
fn how_to_get(name: &str, provider: &str) -> String {
    if name == VagrantSettings::default().name && ["libvirt", "virtualbox"].contains(&provider) {
        return format!(
            "vagrant box add --name {name} \"$(vagrant/box/build {provider} ARCHITECTURE)\", with the script of matrix: \
             vagrant/README.md"
        );
    }
    format!(
        "vagrant box add {name}; `vagrant/box/build` of matrix makes matrix/debian-12 for libvirt and virtualbox"
    )
}

async fn end_of(host: &dyn Host, (program, arguments): Probe) -> Result<Exit, ProviderError> {
    let program = Program::new(program, arguments.iter().copied());
    let (exit, _) = run(host, &program, b"", TIMEOUT).await?;
    Ok(exit)
}

/// What Vagrant printed; none where it is not there or does not want to.
async fn ask(host: &dyn Host, arguments: &[&str]) -> Result<Option<String>, ProviderError> {
    let (exit, printed) = run(host, &machine::vagrant(Path::new("/"), arguments), b"", TIMEOUT).await?;
    Ok(exit
        .success()
        .then(|| String::from_utf8_lossy(&printed).into_owned()))
}

/// Whether the list has the box, for that provider and in that version.
fn has_box(printed: &str, provider: &str, settings: &VagrantSettings) -> bool {
    let mut name = String::new();
    let mut fits = false;
    for line in output::read(printed) {
        let value = line.data.into_iter().next().unwrap_or_default();
        match line.kind.as_str() {
            "box-name" => (name, fits) = (value, false),
            "box-provider" => fits = name == settings.name && value == provider,
            "box-version" if fits => match &settings.box_version {
                Some(wanted) if *wanted != value => {}
                _ => return true,
            },
            _ => {}
        }
    }
    false
}

#[cfg(test)]
mod tests {
    use super::*;

    /// As Vagrant 2.3.4 printed it, cut.
    const BOXES: &str = "\
1795272478,,box-name,debian/bookworm64
1795272478,,box-provider,virtualbox
1795272478,,box-version,12.1
1795272478,,box-name,debian/bookworm64
1795272478,,box-provider,libvirt
1795272478,,box-version,12.2
1795272478,,box-name,matrix/debian-12
1795272478,,box-provider,libvirt
1795272478,,box-version,0
";

    /// As virsh of libvirt 9.0.0 printed it.
    const VIRSH: &str = "\
Compiled against library: libvirt 9.0.0
Using library: libvirt 9.0.1
Using API: QEMU 9.0.1
Running hypervisor: QEMU 10.0.2

";
    /// As VirtualBox's manual has it, on a machine without its kernel module.
    const VBOXMANAGE: &str = "\
WARNING: The vboxdrv kernel module is not loaded. Either there is no module
         available for the current kernel (6.1.0-18-amd64) or it failed to
         load.
7.0.20r163906
";

    #[rstest::rstest]
    #[case(VIRSH, json!({(fact::LIBVIRT): "9.0.1", (fact::QEMU): "10.0.2"}))]
    #[case(VBOXMANAGE, json!({"virtualbox": "7.0.20r163906"}))]
    #[case("", json!({}))]
    fn versions_are_read_where_they_are_printed(#[case] printed: &str, #[case] versions: Value) {
        assert_eq!(Value::Object(versions_in(printed)), versions);
    }

    #[rstest::rstest]
    #[case(
        "matrix/debian-12",
        "virtualbox",
        "$(vagrant/box/build virtualbox ARCHITECTURE)"
    )]
    #[case("matrix/debian-12", "qemu", "vagrant box add matrix/debian-12; ")]
    #[case("debian/bookworm64", "libvirt", "vagrant box add debian/bookworm64; ")]
    fn the_box_that_matrix_makes_comes_with_its_recipe(
        #[case] name: &str,
        #[case] provider: &str,
        #[case] words: &str,
    ) {
        assert!(how_to_get(name, provider).contains(words));
    }

    #[rstest::rstest]
    #[case::there("debian/bookworm64", None, "libvirt", true)]
    #[case::that_version("debian/bookworm64", Some("12.2"), "libvirt", true)]
    #[case::version_of_another_provider("debian/bookworm64", Some("12.1"), "libvirt", false)]
    #[case::of_another_provider("matrix/debian-12", None, "virtualbox", false)]
    #[case::none_of_that_name("debian/trixie64", None, "libvirt", false)]
    fn a_box_counts_for_its_provider_and_version(
        #[case] name: &str,
        #[case] version: Option<&str>,
        #[case] provider: &str,
        #[case] is_there: bool,
    ) {
        let settings = VagrantSettings {
            name: name.to_owned(),
            box_version: version.map(str::to_owned),
            ..VagrantSettings::default()
        };
        assert_eq!(has_box(BOXES, provider, &settings), is_there);
    }
}
