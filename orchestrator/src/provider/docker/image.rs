//! The image that containers are made of: the workload alone, or on top of an image that the user names. Built by the
//! engine from `dockerfiles/workload.Dockerfile` and the workload for its machine. The function is [`ensure`].

use std::collections::HashMap;

use bollard::{body_full, query_parameters::BuildImageOptionsBuilder};
use futures_util::TryStreamExt as _;
use tokio::sync::Mutex;

use super::{
    engine::{Engine, Workload, if_there, translate},
    labels::Labels,
    recipe,
};
use crate::provider::ProviderError;

const DOCKERFILE: &str = include_str!("../../../../dockerfiles/workload.Dockerfile");
const REPOSITORY: &str = "matrix-workload";
/// An image without a file: what a container of a job is made of, which sees the workload on its node.
pub const EMPTY: &str = "matrix-workload:empty";
/// What `dockerfiles/mininet/build` makes.
const MININET: &str = "matrix-mininet:debian-12";

/// An image on the engine that has our workload in it.
#[derive(Debug, Clone, PartialEq, Eq)]
pub struct Image {
    /// Its name with its tag.
    pub name: String,
    /// Its digest, `sha256:…`.
    pub id: String,
    /// What it was built upon: a name and a digest, if not on nothing.
    pub base: Option<(String, String)>,
    /// The SHA-256 of the workload in it, where that is known.
    pub workload_sha256: Option<String>,
}

/// The image for containers upon `base`, built if the engine does not have it.
///
/// # Errors
/// When there is no workload for the engine's machine, or the engine does not have the base, or does not build the image.
pub async fn ensure(engine: &Engine, base: Option<&str>) -> Result<Image, ProviderError> {
    let base = match base {
        Some(name) => Some((name.to_owned(), base_id(engine, name).await?)),
        None => None,
    };
    let workload = engine.workload()?;
    let name = name(workload, base.as_ref().map(|(_, id)| id.as_str()));
    // Two builds at once would both be done, and one of the images be left without its name.
    static BUILDING: Mutex<()> = Mutex::const_new(());
    let _building = BUILDING.lock().await;
    let id = match existing(engine, &name, workload).await? {
        Some(id) => id,
        None => {
            let base = base.as_ref().map(|(name, _)| name.as_str());
            build(engine, &name, workload, base).await?;
            let built = existing(engine, &name, workload).await?;
            built.ok_or_else(|| ProviderError::NotFound {
                what: format!("the image {name}, just built,"),
            })?
        }
    };
    Ok(Image {
        name,
        id,
        base,
        workload_sha256: Some(workload.sha256.clone()),
    })
}

/// Why the engine cannot make the image, if it lacks the base.
///
/// # Errors
/// The same as [`ensure`].
pub async fn base_id(engine: &Engine, base: &str) -> Result<String, ProviderError> {
    let action = format!("looking for the image {base}");
    let found = if_there(&action, engine.api.inspect_image(base).await)?;
    found
        .and_then(|image| image.id)
        .ok_or_else(|| ProviderError::Unsupported {
            provider: "docker".to_owned(),
            reason: format!("the engine does not have the image `{base}` that providers.docker.image names"),
            hint: Some(match base {
                MININET => "make it with `dockerfiles/mininet/build` of matrix, or bring it there: docs/network.md".to_owned(),
                _ => format!(
                    "fetch or build it first, for instance with `docker pull {base}`: matrix itself pulls nothing"
                ),
            }),
        })
}

/// The name of the image with that digest; the digest where it has lost its name.
///
/// # Errors
/// When the engine cannot be asked.
pub async fn name_of(engine: &Engine, id: &str) -> Result<String, ProviderError> {
    let found = if_there(
        "looking for the container's image",
        engine.api.inspect_image(id).await,
    )?;
    let names = found.and_then(|image| image.repo_tags).unwrap_or_default();
    let own = names.iter().find(|name| is_our_name(std::slice::from_ref(name)));
    Ok(own.cloned().unwrap_or_else(|| id.to_owned()))
}

/// Its tag says which workload and which base, so that a change of either makes another image.
fn name(workload: &Workload, base_id: Option<&str>) -> String {
    let short = |hash: &str| hash.chars().take(12).collect::<String>();
    let workload = short(&workload.sha256);
    match base_id {
        None => format!("{REPOSITORY}:{workload}"),
        Some(id) => format!(
            "{REPOSITORY}:{workload}-on-{}",
            short(id.strip_prefix("sha256:").unwrap_or(id))
        ),
    }
}

/// Whether images with these names can be ours: somebody else's that were made from ours have others.
pub fn is_our_name(names: &[String]) -> bool {
    names.iter().all(|name| {
        let repository = name.split(':').next().unwrap_or_default();
        [REPOSITORY, recipe::REPOSITORY].contains(&repository)
    })
}

/// The digest of the image of that name, if it is what the name says.
async fn existing(engine: &Engine, name: &str, workload: &Workload) -> Result<Option<String>, ProviderError> {
    let action = format!("looking for the image {name}");
    let found = if_there(&action, engine.api.inspect_image(name).await)?;
    Ok(found.and_then(|image| {
        let labels = Labels::read(image.config.and_then(|config| config.labels));
        image
            .id
            .filter(|_| labels.workload().as_ref() == Some(&workload.sha256))
    }))
}

async fn build(
    engine: &Engine,
    name: &str,
    workload: &Workload,
    base: Option<&str>,
) -> Result<(), ProviderError> {
    let action = format!("building the image {name}");
    let context = archive(
        &action,
        &[("Dockerfile", 0o644, DOCKERFILE.as_bytes()), file_of(workload)],
    )?;
    let options = BuildImageOptionsBuilder::default()
        .dockerfile("Dockerfile")
        .t(name)
        .rm(true)
        .forcerm(true)
        .networkmode("none")
        .labels(&Labels::of_image(&workload.sha256).write())
        .buildargs(&HashMap::from([("BASE", base.unwrap_or("scratch"))]))
        .build();
    engine
        .api
        .build_image(options, None, Some(body_full(context.into())))
        .try_for_each(|_| async { Ok(()) })
        .await
        .map_err(|error| translate(&action, error))
}

/// A file for the engine: its name, its mode and what is in it.
type File<'a> = (&'static str, u32, &'a [u8]);

/// The workload, which is at the root of every container.
#[must_use]
pub fn file_of(workload: &Workload) -> File<'_> {
    ("workload", 0o755, &workload.binary)
}

/// Files as a tar archive, as an engine takes them. Without times, so that the engine's cache knows them again.
///
/// # Errors
/// When this machine has no memory for it.
pub fn archive(action: &str, files: &[File<'_>]) -> Result<Vec<u8>, ProviderError> {
    let mut archive = tar::Builder::new(Vec::new());
    let mut pack = || {
        for (path, mode, content) in files {
            let mut header = tar::Header::new_gnu();
            header.set_size(content.len() as u64);
            header.set_mode(*mode);
            archive.append_data(&mut header, path, *content)?;
        }
        archive.finish()
    };
    let packed = pack();
    packed
        .and_then(|()| archive.into_inner())
        .map_err(|source| ProviderError::of_this_machine(action, source))
}

#[cfg(test)]
mod tests {
    use super::*;

    fn workload(binary: &'static [u8]) -> Workload {
        Workload::new(binary.into())
    }

    #[test]
    fn the_tag_tells_workload_and_base() {
        let ours = workload(b"ours");
        let alone = name(&ours, None);
        assert_eq!(alone.len(), REPOSITORY.len() + 1 + 12);
        let upon = name(&ours, Some("sha256:0123456789abcdef"));
        assert_eq!(upon, format!("{alone}-on-0123456789ab"));
        assert_ne!(name(&workload(b"another machine's"), None), alone);
    }

    #[rstest::rstest]
    #[case(&["matrix-workload:0123"], true)]
    #[case(&[], true)]
    #[case(&["matrix-recipe:0123-amd64"], true)]
    #[case(&["matrix-workload-2:0123"], false)]
    #[case(&["matrix-workload:0123", "mine:1"], false)]
    fn an_image_with_a_name_that_another_gave_it_is_not_ours(#[case] names: &[&str], #[case] ours: bool) {
        let names: Vec<_> = names.iter().map(ToString::to_string).collect();
        assert_eq!(is_our_name(&names), ours);
    }

    #[test]
    fn an_archive_has_its_files_and_a_binary_that_can_be_run() {
        let packed = archive(
            "packing",
            &[
                ("Dockerfile", 0o644, b"FROM scratch"),
                file_of(&workload(b"ours")),
            ],
        )
        .unwrap();
        let mut archive = tar::Archive::new(packed.as_slice());
        let entries: Vec<_> = archive
            .entries()
            .unwrap()
            .map(|entry| {
                let entry = entry.unwrap();
                (entry.path().unwrap().into_owned(), entry.header().mode().unwrap())
            })
            .collect();
        assert_eq!(
            entries,
            [("Dockerfile".into(), 0o644), ("workload".into(), 0o755)]
        );
    }
}
