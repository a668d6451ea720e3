//! An image of Debian packages, made here and handed to the engine: `providers.docker.recipe`. There is no registry in it. The main
//! type is [`Recipe`].
//!
//! The root of the image is made by `vagrant/box/root`, which also makes the boxes and the images of `dockerfiles/`, so that one script
//! knows how Debian is unpacked. It is in this program, with the one beside it that finds the machine's mirror of Debian.

use std::{collections::HashMap, fmt, path::Path, process::Stdio, time::Duration};

use bollard::{body_try_stream, query_parameters::CreateImageOptionsBuilder};
use futures_util::TryStreamExt as _;
use schemars::JsonSchema;
use serde::{Deserialize, Serialize};
use sha2::{Digest as _, Sha256};
use tokio::{fs::File, process::Command, sync::Mutex};
use tokio_util::io::ReaderStream;

use super::{
    engine::{Engine, if_there, translate},
    labels::Labels,
};
use crate::provider::ProviderError;

const ROOT: &str = include_str!("../../../../vagrant/box/root");
const MIRROR: &str = include_str!("../../../../vagrant/box/mirror");
/// What the names of its images begin with.
pub const REPOSITORY: &str = "matrix-recipe";
/// A hundred packages take minutes, from a slow mirror many.
const TIMEOUT: Duration = Duration::from_secs(3600);
/// What is told of what the script printed.
const LAST_LINES: usize = 12;
/// More an image for one experiment does not need.
const MOST_PACKAGES: usize = 100;

/// What an image is made of.
#[derive(Debug, Clone, PartialEq, Eq, Serialize, Deserialize, JsonSchema)]
#[serde(deny_unknown_fields)]
pub struct Recipe {
    /// Packages of Debian 12, such as `[python3, python3-numpy]`, which come with all that they depend on.
    #[serde(deserialize_with = "packages")]
    pub packages: Vec<Package>,
}

/// The name of a Debian package, with a version if it is to be that one: `python3-numpy`, `gcc=4:12.2.0-3`.
#[derive(Debug, Clone, PartialEq, Eq, PartialOrd, Ord, Serialize, Deserialize, JsonSchema)]
#[serde(try_from = "String")]
pub struct Package(String);

/// A text that names no package.
#[derive(Debug, Clone, PartialEq, Eq, thiserror::Error)]
#[error(
    "`{0}` is no package of Debian: write a name such as `python3-numpy`, or with a version, `gcc=4:12.2.0-3`"
)]
pub struct NotAPackage(String);

impl TryFrom<String> for Package {
    type Error = NotAPackage;

    /// As Debian's policy has names (5.6.1) and versions (5.6.12).
    fn try_from(text: String) -> Result<Self, NotAPackage> {
        let lower = |byte: u8| byte.is_ascii_lowercase() || byte.is_ascii_digit();
        let is_name = |name: &str| {
            name.len() >= 2
                && name.starts_with(|first: char| first.is_ascii_lowercase() || first.is_ascii_digit())
                && name.bytes().all(|byte| lower(byte) || b"+-.".contains(&byte))
        };
        let is_version = |version: &str| {
            version.starts_with(|first: char| first.is_ascii_digit())
                && version
                    .bytes()
                    .all(|byte| byte.is_ascii_alphanumeric() || b".+-:~".contains(&byte))
        };
        let is_package = match text.split_once('=') {
            Some((name, version)) => is_name(name) && is_version(version),
            None => is_name(&text),
        };
        match is_package && text.len() <= 200 {
            true => Ok(Self(text)),
            false => Err(NotAPackage(text)),
        }
    }
}

impl fmt::Display for Package {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        f.write_str(&self.0)
    }
}

fn packages<'de, D: serde::Deserializer<'de>>(from: D) -> Result<Vec<Package>, D::Error> {
    let packages = Vec::<Package>::deserialize(from)?;
    match packages.len() {
        0 => Err(serde::de::Error::custom(
            "an image of no packages has no program: name one such as `python3`",
        )),
        count if count > MOST_PACKAGES => Err(serde::de::Error::custom(format!(
            "{count} packages are more than {MOST_PACKAGES}: build the image yourself, and name it as `image`"
        ))),
        _ => Ok(packages),
    }
}

impl Recipe {
    /// The name of its image for an engine of that architecture. A change of the packages or of the script makes another.
    #[must_use]
    pub fn image(&self, architecture: &str) -> String {
        let mut packages = self.packages.clone();
        packages.sort();
        packages.dedup();
        let mut hash = Sha256::new();
        hash.update(ROOT);
        for package in &packages {
            hash.update(format!("{package}\n"));
        }
        let hash: String = format!("{:x}", hash.finalize()).chars().take(16).collect();
        format!("{REPOSITORY}:{hash}-{architecture}")
    }

    /// Whether the engine has its image; why it cannot be made here, if it has not.
    ///
    /// # Errors
    /// The same as [`Self::ensure`], as far as it can be known beforehand.
    pub async fn look(&self, engine: &Engine) -> Result<bool, ProviderError> {
        if self.has(engine).await? {
            return Ok(true);
        }
        let unsupported = |reason: String, hint: &str| ProviderError::Unsupported {
            provider: super::NAME.to_owned(),
            reason: format!("the image of `providers.docker.recipe` cannot be made here: {reason}"),
            hint: Some(hint.to_owned()),
        };
        if !matches!(engine.architecture.as_str(), "amd64" | "arm64")
            || engine.kernel_machine != std::env::consts::ARCH
        {
            return Err(unsupported(
                format!(
                    "the engine is for {}, and this machine for {}",
                    engine.architecture,
                    std::env::consts::ARCH
                ),
                "build an image on that machine, and name it as `providers.docker.image`",
            ));
        }
        if !rustix::process::geteuid().is_root() {
            return Err(unsupported(
                "only root may make device nodes".to_owned(),
                "run `matrix` as root once, or name an image that the engine has as `providers.docker.image`",
            ));
        }
        if !Path::new("/usr/bin/mmdebstrap").exists() {
            return Err(unsupported(
                "mmdebstrap is not installed".to_owned(),
                "install it: `apt-get install mmdebstrap debian-archive-keyring`",
            ));
        }
        Ok(false)
    }

    /// The name of its image, which is made if the engine has not got it.
    ///
    /// # Errors
    /// When it cannot be made here, a package does not exist, or the engine refuses it.
    pub async fn ensure(&self, engine: &Engine) -> Result<String, ProviderError> {
        // Environments of one run may ask for it at once.
        static BUILDING: Mutex<()> = Mutex::const_new(());
        let _building = BUILDING.lock().await;
        if !self.look(engine).await? {
            let name = self.image(&engine.architecture);
            let folder = tempfile::tempdir()
                .map_err(|error| ProviderError::of_this_machine("making a folder for the image", error))?;
            let root = folder.path().join("root.tar");
            self.make_root(&engine.architecture, folder.path(), &root).await?;
            hand_over(engine, &name, &root).await?;
        }
        Ok(self.image(&engine.architecture))
    }

    async fn has(&self, engine: &Engine) -> Result<bool, ProviderError> {
        let name = self.image(&engine.architecture);
        let found = if_there(
            "looking for the recipe's image",
            engine.api.inspect_image(&name).await,
        )?;
        let labels = found.and_then(|image| image.config).map(|config| config.labels);
        // Anybody could give an image that name.
        Ok(labels.is_some_and(|labels| Labels::read(labels).are_of_our_image()))
    }

    /// Unpacks the packages into an archive.
    async fn make_root(&self, architecture: &str, folder: &Path, root: &Path) -> Result<(), ProviderError> {
        const ACTION: &str = "making an image of Debian packages";
        let write = |name: &str, text: &str| {
            let path = folder.join(name);
            std::fs::write(&path, text)?;
            Ok::<_, std::io::Error>(path)
        };
        let packages: String = self
            .packages
            .iter()
            .map(|package| format!("{package}\n"))
            .collect();
        let written = (|| -> std::io::Result<_> {
            let mirror = write("mirror", MIRROR)?;
            std::fs::set_permissions(&mirror, std::os::unix::fs::PermissionsExt::from_mode(0o700))?;
            Ok((write("root", ROOT)?, write("packages", &packages)?))
        })();
        let (script, list) = written.map_err(|error| ProviderError::of_this_machine(ACTION, error))?;
        let running = Command::new("bash")
            .arg(script)
            .args([
                architecture.as_ref(),
                root.as_os_str(),
                list.as_os_str(),
                "--".as_ref(),
            ])
            .stdin(Stdio::null())
            .stdout(Stdio::null())
            .stderr(Stdio::piped())
            .kill_on_drop(true)
            .output();
        let ended = tokio::time::timeout(TIMEOUT, running)
            .await
            .map_err(|_| ProviderError::TimedOut {
                action: ACTION.to_owned(),
                after: TIMEOUT,
            })?;
        let ended = ended.map_err(|error| ProviderError::of_this_machine(ACTION, error))?;
        if ended.status.success() {
            return Ok(());
        }
        let said = String::from_utf8_lossy(&ended.stderr).into_owned();
        let lines: Vec<&str> = said.lines().collect();
        let last = lines
            .get(lines.len().saturating_sub(LAST_LINES)..)
            .unwrap_or_default();
        Err(ProviderError::Unsupported {
            provider: super::NAME.to_owned(),
            reason: format!("the image of `providers.docker.recipe` was not made: {}", last.join(" | ")),
            hint: Some("see whether Debian 12 has these packages (`apt-cache policy NAME`), and whether its mirror answers".to_owned()),
        })
    }
}

/// Gives the engine an archive as an image of that name.
async fn hand_over(engine: &Engine, name: &str, root: &Path) -> Result<(), ProviderError> {
    let action = format!("importing the image {name}");
    let file = File::open(root)
        .await
        .map_err(|error| ProviderError::of_this_machine(&action, error))?;
    let (repository, tag) = name.split_once(':').unwrap_or((name, "latest"));
    let labels: HashMap<String, String> = Labels::of_image_without_workload().write();
    let changes: Vec<String> = labels
        .iter()
        .map(|(label, value)| format!("LABEL {label}={value}"))
        .collect();
    let options = CreateImageOptionsBuilder::default()
        .from_src("-")
        .repo(repository)
        .tag(tag)
        .changes(changes)
        .build();
    let body = body_try_stream(ReaderStream::with_capacity(file, 1 << 20));
    engine
        .api
        .create_image(Some(options), Some(body), None)
        .try_for_each(|_| async { Ok(()) })
        .await
        .map_err(|error| translate(&action, error))
}

#[cfg(test)]
mod tests {
    use super::*;

    fn recipe(packages: &[&str]) -> Recipe {
        serde_json::from_value(serde_json::json!({ "packages": packages })).unwrap()
    }

    #[rstest::rstest]
    #[case("python3", true)]
    #[case("libstdc++6", true)]
    #[case("gcc=4:12.2.0-3", true)]
    #[case("7zip", true)]
    #[case("a", false)]
    #[case("Python3", false)]
    #[case("-oDpkg::Options", false)]
    #[case("python3 curl", false)]
    #[case("python3,curl", false)]
    #[case("python3;reboot", false)]
    #[case("python3=", false)]
    #[case("python3/sid", false)]
    #[case("../python3", false)]
    #[case("# comment", false)]
    fn a_package_has_a_name_of_debians(#[case] name: &str, #[case] is_one: bool) {
        assert_eq!(Package::try_from(name.to_owned()).is_ok(), is_one);
    }

    #[test]
    fn the_image_is_known_by_its_packages_whatever_their_order() {
        let image = recipe(&["python3", "gcc"]).image("amd64");
        assert!(
            image.starts_with("matrix-recipe:") && image.ends_with("-amd64"),
            "{image}"
        );
        assert_eq!(recipe(&["gcc", "python3", "gcc"]).image("amd64"), image);
        assert_ne!(recipe(&["python3"]).image("amd64"), image);
        assert_ne!(recipe(&["python3", "gcc"]).image("arm64"), image);
    }

    #[test]
    fn of_nothing_and_of_too_much_there_is_no_recipe() {
        let read = |packages: Vec<String>| {
            serde_json::from_value::<Recipe>(serde_json::json!({ "packages": packages }))
        };
        assert!(
            read(Vec::new())
                .unwrap_err()
                .to_string()
                .contains("has no program")
        );
        let many = (0..=MOST_PACKAGES).map(|number| format!("lib{number}")).collect();
        assert!(read(many).unwrap_err().to_string().contains("are more than 100"));
    }
}
