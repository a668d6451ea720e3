//! The machine of one environment: a folder on its host with what Vagrant goes by, and what Vagrant does there. The main
//! type is [`Machine`]; [`MachineFolders`] are all of a host.
//!
//! Each has a folder and a state of its own, so that neither other runs nor other people's machines are ever touched.

use std::{
    collections::BTreeMap,
    path::{Path, PathBuf},
    sync::Arc,
    time::Duration,
};

use record::{detached::Owner, layout, run_directory::VagrantBox};
use serde_json::{Value, json};
use tokio::time::{Instant, sleep};

use super::{
    VagrantSettings,
    output::{self, Line, VagrantFailure},
    ssh_config::{self, SshConfig},
};
use crate::{
    host::{Exit, Host, Program, output},
    provider::ProviderError,
};

/// What every machine goes by; the rest is in `machine.json`.
const VAGRANTFILE: &str = include_str!("../../../../vagrant/Vagrantfile");
/// A call that only asks. Vagrant itself takes seconds to start.
const ASKING: Duration = Duration::from_secs(120);
/// Making or removing a disk, on a slow one.
const MAKING: Duration = Duration::from_secs(1800);
/// How long another call that has the machine is waited for, and how often it is looked.
const LOCKED: Duration = Duration::from_secs(300);
const LOOK: Duration = Duration::from_secs(2);

/// Makes the folder `$2` below `$1`, which appears with all its files or not at all. The files come as a tar.
const PUT: &str = r#"
umask 077
mkdir -p "$1" || exit
rm -rf "$1"/.making.*
[ ! -e "$1/$2" ] || { echo "there is a $1/$2 already" >&2; exit 1; }
mkdir "$1/.making.$2" && tar -xf - -C "$1/.making.$2" && mv "$1/.making.$2" "$1/$2"
"#;
/// Whether Vagrant was ever at work in it.
const BEGUN: &str = r#"if [ -d "$1/$2/.vagrant" ]; then echo begun; fi"#;
const REMOVE: &str = r#"rm -rf "$1/$2""#;
/// One line for each folder: its name, a tab, its owner.
const LIST: &str = r#"
cd "$1" 2>/dev/null || exit 0
for folder in */; do
    [ -d "$folder" ] || continue
    printf '%s\t' "${folder%/}"
    cat "$folder/owner.json" 2>/dev/null | tr -d '\n'
    echo
done
"#;
/// Writes the digest of the box's files to `box.sha256` in the machine's folder: of a list as `sha256sum` prints it, in the
/// order of bytes. Vagrant names the box's folder in `box_meta`, from its own folder on.
const DIGEST_BOX: &str = r#"
cd "$1/$2" || exit
folder=$(sed -n 's/.*"directory" *: *"\([^"]*\)".*/\1/p' .vagrant/machines/machine/*/box_meta)
case $folder in
    "") exit ;;
    /*) ;;
    *) folder=${VAGRANT_HOME:-$HOME/.vagrant.d}/$folder ;;
esac
if command -v sha256sum >/dev/null; then sum() { sha256sum "$@"; }; else sum() { shasum -a 256 "$@"; }; fi
list=$(cd "$folder" && find . -type f | LC_ALL=C sort | while IFS= read -r file; do sum "$file" || exit; done) &&
    digest=$(printf '%s\n' "$list" | sum) && echo "${digest%% *}" >box.sha256
"#;
/// The digest in a line of its own, which is empty where there is none, then what Vagrant knows of the box.
const MADE_OF: &str = r#"
cd "$1/$2" && { cat box.sha256 2>/dev/null || echo; } && cat .vagrant/machines/machine/*/box_meta
"#;

/// The box that [`MADE_OF`] printed.
fn made_of(printed: &str) -> Option<VagrantBox> {
    let (digest, known) = printed.split_once('\n')?;
    let is_digest = digest.len() == 64 && digest.bytes().all(|byte| byte.is_ascii_hexdigit());
    let made_of: VagrantBox = serde_json::from_str(known).ok()?;
    Some(VagrantBox {
        sha256: is_digest.then(|| digest.to_owned()),
        ..made_of
    })
}

/// The folders of machines on a host.
#[derive(Clone)]
pub struct MachineFolders {
    host: Arc<dyn Host>,
    root: PathBuf,
}

/// One machine, which may not be there yet or any more.
#[derive(Clone)]
pub struct Machine {
    folders: MachineFolders,
    name: String,
    provider: &'static str,
}

impl MachineFolders {
    /// Those beside the folder of the host's detached environments.
    #[must_use]
    pub fn beside(host: Arc<dyn Host>, environments: &Path) -> Self {
        Self {
            host,
            root: environments.with_file_name("machines"),
        }
    }

    /// The machine of an environment.
    #[must_use]
    pub fn machine(&self, environment: &str, provider: &'static str) -> Machine {
        Machine {
            folders: self.clone(),
            name: environment.to_owned(),
            provider,
        }
    }

    /// Every machine that has a folder, with what it belongs to.
    ///
    /// # Errors
    /// When the host cannot be asked.
    pub async fn list(&self) -> Result<Vec<(String, Option<Owner>)>, ProviderError> {
        let said = self.shell("listing machines", LIST, "", b"").await?;
        Ok(said
            .lines()
            .filter_map(|line| line.split_once('\t'))
            .map(|(name, owner)| (name.to_owned(), serde_json::from_str(owner).ok()))
            .collect())
    }

    async fn shell(
        &self,
        action: &str,
        script: &str,
        name: &str,
        input: &[u8],
    ) -> Result<String, ProviderError> {
        let program = self.program(script, name);
        let (exit, said) = output(self.host.as_ref(), &program, input, ASKING).await?;
        if !exit.success() {
            return Err(self.refused(action, None, exit.last_words.trim().to_owned().into()));
        }
        Ok(String::from_utf8_lossy(&said).into_owned())
    }

    /// A script, at work in a machine's folder.
    fn program(&self, script: &str, name: &str) -> Program {
        let root = self.root.as_os_str();
        Program::new(
            "sh",
            ["-c".as_ref(), script.as_ref(), "sh".as_ref(), root, name.as_ref()],
        )
    }

    fn refused(&self, action: &str, hint: Option<String>, source: crate::failure::Cause) -> ProviderError {
        ProviderError::Refused {
            platform: format!("host `{}`", self.host.name()),
            action: action.to_owned(),
            hint,
            source,
        }
    }
}

impl Machine {
    /// Its folder on the host.
    #[must_use]
    pub fn folder(&self) -> PathBuf {
        self.folders.root.join(&self.name)
    }

    /// Makes its folder: from then on it can be found and removed.
    ///
    /// # Errors
    /// When there is one already, or the host refuses.
    pub async fn prepare(&self, owner: &Owner, settings: &VagrantSettings) -> Result<(), ProviderError> {
        let owner = serde_json::to_string(owner).unwrap_or_default();
        let definition = self.definition(settings).to_string();
        let files = [
            (layout::OWNER, owner.as_str()),
            ("Vagrantfile", VAGRANTFILE),
            ("machine.json", &definition),
        ];
        let action = "making the machine's folder";
        let archive = archive(&files).map_err(|error| self.folders.refused(action, None, error.into()))?;
        self.folders
            .shell(action, PUT, &self.name, &archive)
            .await
            .map(drop)
    }

    /// All that the Vagrantfile is told.
    fn definition(&self, settings: &VagrantSettings) -> Value {
        let options = with_network_card(self.provider, settings);
        json!({
            "provider": self.provider,
            "box": settings.name,
            "box_version": settings.box_version,
            "memory_mib": settings.memory.get() >> 20,
            "cpus": settings.cpus,
            "boot_timeout_s": settings.boot_timeout.duration().as_secs(),
            "guest": settings.guest,
            "insert_key": settings.insert_key,
            "options": options,
        })
    }

    /// Makes and boots it, and waits until it can be entered.
    ///
    /// # Errors
    /// With Vagrant's own words when it cannot.
    pub async fn up(&self, boot_timeout: Duration) -> Result<(), ProviderError> {
        self.vagrant(
            "starting the machine",
            &["up", "--provider", self.provider],
            MAKING + boot_timeout,
        )
        .await
        .map(drop)
    }

    /// Reads all of its box, some seconds for a gigabyte; to be called before anything is measured on the host. A box
    /// whose digest cannot be had has none, and costs no window.
    pub async fn digest_box(&self) {
        let program = self.folders.program(DIGEST_BOX, &self.name);
        let _ = output(self.folders.host.as_ref(), &program, b"", MAKING).await;
    }

    /// The box that it was made of; none where Vagrant has not written it down.
    pub async fn made_of(&self) -> Option<VagrantBox> {
        let said = self
            .folders
            .shell("asking for the machine's box", MADE_OF, &self.name, b"");
        made_of(&said.await.ok()?)
    }

    /// Its state in Vagrant's words: `running`, `shutoff`, `poweroff`, `not_created`, …
    ///
    /// # Errors
    /// When Vagrant cannot be asked.
    pub async fn state(&self) -> Result<String, ProviderError> {
        let said = self
            .vagrant("asking for the machine's state", &["status"], ASKING)
            .await?;
        Ok(output::value(&said, "state").unwrap_or("unknown").to_owned())
    }

    /// A shell in it.
    #[must_use]
    pub fn shell(&self) -> Program {
        vagrant(&self.folder(), &["ssh"])
    }

    /// Why nothing can be had from a machine in such a state.
    #[must_use]
    pub fn stands_still(&self, state: &str) -> ProviderError {
        let folder = self.folder();
        self.folders.refused(
            &format!("entering the machine {}", self.name),
            Some(format!(
                "`vagrant up` in {} starts it again, then `matrix resume`; `matrix clean` removes it",
                folder.display()
            )),
            format!("it does not run: Vagrant calls it `{state}`").into(),
        )
    }

    /// The way into it.
    ///
    /// # Errors
    /// When it does not run, or Vagrant cannot be asked.
    pub async fn way_in(&self) -> Result<SshConfig, ProviderError> {
        let action = "asking for the way into the machine";
        let said = self.call(&["ssh-config"], ASKING).await?;
        let printed = self.judged(action, said)?;
        ssh_config::read(&printed)
            .ok_or_else(|| self.folders.refused(action, None, "it names no address".into()))
    }

    /// Why it cannot be entered when Vagrant names no key.
    #[must_use]
    pub fn without_a_key(&self) -> ProviderError {
        let action = format!("entering the machine {}", self.name);
        self.folders
            .refused(&action, None, "Vagrant names no key for it".into())
    }

    /// A private key that Vagrant names, which is a file of its host.
    ///
    /// # Errors
    /// When it cannot be read.
    pub async fn key(&self, identity: &Path) -> Result<Vec<u8>, ProviderError> {
        let program = Program::new("cat", [identity]);
        let (exit, key) = output(self.folders.host.as_ref(), &program, b"", ASKING).await?;
        match exit.success() {
            true => Ok(key),
            false => Err(self.folders.refused(
                "reading the machine's key",
                None,
                exit.last_words.trim().to_owned().into(),
            )),
        }
    }

    /// Removes it and its folder. What is gone already is fine.
    ///
    /// # Errors
    /// With Vagrant's own words when it cannot; the folder stays then.
    pub async fn remove(&self) -> Result<(), ProviderError> {
        let there = self.folders.list().await?;
        if !there.iter().any(|(name, _)| *name == self.name) {
            return Ok(());
        }
        let action = "removing the machine's folder";
        let begun = self.folders.shell(action, BEGUN, &self.name, b"").await?;
        if !begun.is_empty() {
            self.vagrant("removing the machine", &["destroy", "--force"], MAKING)
                .await?;
        }
        self.folders
            .shell(action, REMOVE, &self.name, b"")
            .await
            .map(drop)
    }

    /// Calls Vagrant for this machine, again for as long as another call has it.
    async fn vagrant(
        &self,
        action: &str,
        arguments: &[&str],
        timeout: Duration,
    ) -> Result<Vec<Line>, ProviderError> {
        let arguments = [&["--machine-readable"], arguments].concat();
        let give_up = Instant::now() + LOCKED;
        loop {
            let said = self.call(&arguments, timeout).await?;
            let locked = !said.0.success() && {
                let class = output::failure(&said.1, &said.0.last_words).class;
                class.ends_with("MachineLocked") || class.ends_with("EnvironmentLockedError")
            };
            if !locked || Instant::now() > give_up {
                return self.judged(action, said).map(|printed| output::read(&printed));
            }
            sleep(LOOK).await;
        }
    }

    async fn call(&self, arguments: &[&str], timeout: Duration) -> Result<(Exit, String), ProviderError> {
        let program = vagrant(&self.folder(), arguments);
        let (exit, said) = output(self.folders.host.as_ref(), &program, b"", timeout).await?;
        Ok((exit, String::from_utf8_lossy(&said).into_owned()))
    }

    fn judged(&self, action: &str, (exit, printed): (Exit, String)) -> Result<String, ProviderError> {
        if exit.success() {
            return Ok(printed);
        }
        let failure = output::failure(&printed, &exit.last_words);
        let hint = hint(&failure).map(str::to_owned);
        Err(ProviderError::Refused {
            platform: format!("Vagrant on host `{}`", self.folders.host.name()),
            action: action.to_owned(),
            hint,
            source: failure.into(),
        })
    }
}

/// Vagrant, at work in a folder.
pub fn vagrant(folder: &Path, arguments: &[&str]) -> Program {
    let mut cwd = std::ffi::OsString::from("VAGRANT_CWD=");
    cwd.push(folder);
    let surroundings = [
        cwd,
        // It would ask its maker whether it is the newest.
        "VAGRANT_CHECKPOINT_DISABLE=1".into(),
        "VAGRANT_NO_COLOR=1".into(),
        "LC_ALL=C.UTF-8".into(),
        "vagrant".into(),
    ];
    Program::new(
        "env",
        surroundings.into_iter().chain(arguments.iter().map(Into::into)),
    )
}

/// All options of a provider. Those of the file come last, so that they hold where both name a card.
fn with_network_card(provider: &str, settings: &VagrantSettings) -> BTreeMap<String, Value> {
    let mut options = settings.options.clone();
    if let Some((name, ours)) = network_card(provider, settings.network_card.as_deref()) {
        match (options.get_mut(name), ours) {
            // A list of commands, which has a place for one more.
            (Some(Value::Array(theirs)), Value::Array(mut ours)) => {
                ours.append(theirs);
                *theirs = ours;
            }
            (Some(_), _) => {}
            (None, ours) => drop(options.insert(name.to_owned(), ours)),
        }
    }
    options
}

/// The option by which a provider is told the card's model. Who knows another names it under `options`.
fn network_card(provider: &str, model: Option<&str>) -> Option<(&'static str, Value)> {
    let model = model?;
    match provider {
        "libvirt" => Some(("nic_model_type", json!(model))),
        "virtualbox" => Some(("customize", json!([["modifyvm", ":id", "--nictype1", model]]))),
        _ => None,
    }
}

fn hint(failure: &VagrantFailure) -> Option<&'static str> {
    match failure.class.rsplit("::").next().unwrap_or_default() {
        "VMBootTimeout" | "SSHNotReady" => Some(
            "give it more time with `boot_timeout`, or see whether the box has the user and key that Vagrant expects",
        ),
        "MachineLocked" | "EnvironmentLockedError" => {
            Some("another `vagrant` has this machine: wait for it or end it, then `matrix resume`")
        }
        "BoxNotFound" | "BoxAddShortNotFound" | "BoxNotFoundWithProvider" => {
            Some("`vagrant box add` it; `vagrant/box/build` of matrix makes one for libvirt")
        }
        _ => None,
    }
}

fn archive(files: &[(&str, &str)]) -> std::io::Result<Vec<u8>> {
    let mut archive = tar::Builder::new(Vec::new());
    for (name, text) in files {
        let mut header = tar::Header::new_gnu();
        header.set_size(text.len() as u64);
        header.set_mode(0o600);
        archive.append_data(&mut header, name, text.as_bytes())?;
    }
    archive.into_inner()
}

#[cfg(test)]
mod tests {
    use std::fs;

    use sha2::{Digest as _, Sha256};

    use super::*;
    use crate::{host::Here, state_directory::StateDirectory};

    /// A machine's folder as Vagrant 2.3.4 leaves it, and a box with two files.
    #[tokio::test]
    async fn a_box_is_known_by_the_content_of_its_files() {
        let folder = tempfile::tempdir().unwrap();
        let there = folder.path().join("box dir/0/libvirt");
        fs::create_dir_all(&there).unwrap();
        fs::write(there.join("metadata.json"), "{}").unwrap();
        fs::write(there.join("box.img"), "disk").unwrap();
        let known = folder.path().join("machines/m/.vagrant/machines/machine/libvirt");
        fs::create_dir_all(&known).unwrap();
        let meta =
            json!({"name": "matrix/debian-12", "version": "0", "provider": "libvirt", "directory": there});
        fs::write(known.join("box_meta"), meta.to_string()).unwrap();

        let host: Arc<dyn Host> = Arc::new(Here::new("here", StateDirectory::of_this_user()));
        let folders = MachineFolders::beside(host, &folder.path().join("environments"));
        let machine = folders.machine("m", "libvirt");
        let made_of = |sha256| {
            Some(VagrantBox {
                name: "matrix/debian-12".to_owned(),
                version: "0".to_owned(),
                sha256,
            })
        };
        assert_eq!(machine.made_of().await, made_of(None));

        machine.digest_box().await;
        let list = format!(
            "{:x}  ./box.img\n{:x}  ./metadata.json\n",
            Sha256::digest("disk"),
            Sha256::digest("{}")
        );
        let digest = Some(format!("{:x}", Sha256::digest(list)));
        assert_eq!(machine.made_of().await, made_of(digest));
        assert_eq!(folders.machine("none", "libvirt").made_of().await, None);
    }

    #[test]
    fn a_network_card_is_set_beside_what_else_is_customized() {
        let settings = |options: Value| VagrantSettings {
            network_card: Some("virtio".to_owned()),
            options: serde_json::from_value(options).unwrap(),
            ..VagrantSettings::default()
        };
        let customized = settings(json!({"customize": [["modifyvm", ":id", "--audio-driver", "none"]]}));
        assert_eq!(
            json!(with_network_card("virtualbox", &customized)),
            json!({"customize": [
                ["modifyvm", ":id", "--nictype1", "virtio"],
                ["modifyvm", ":id", "--audio-driver", "none"],
            ]})
        );
        let named = settings(json!({"nic_model_type": "e1000"}));
        assert_eq!(
            json!(with_network_card("libvirt", &named)),
            json!({"nic_model_type": "e1000"})
        );
        assert_eq!(
            json!(with_network_card("libvirt", &settings(json!({})))),
            json!({"nic_model_type": "virtio"})
        );
    }
}
