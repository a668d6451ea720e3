//! Each environment is a job of a batch system: whole node, once, and in need of nobody while it measures. The main type is
//! [`Jobs`].
//!
//! ```text
//! create:   folder on the shared file system ── prepare; then sbatch, after the job before it
//! measure:  the node ── workload detached job ──> the folder         no matrix has to live
//!           submit host ── squeue, once for all jobs; look ──> lines, the end
//! collect, remove: as on any host, on the submit host
//! ```
//!
//! A job is never requeued: the batch system would begin it on another node under the same number while the first may go on, and two
//! would write to one folder. What is missing is measured in another environment, by another job.

mod environment;
mod probe;

use std::{
    collections::{BTreeSet, VecDeque},
    sync::{Arc, Mutex, PoisonError},
    time::Duration,
};

use async_trait::async_trait;
use record::{
    axis::NATIVE,
    call::Check,
    connection::Nodes,
    detached::{JobContainer, ListedEnvironment},
    layout,
    run_directory::{EnvironmentRecord, JobStanding, Resource, RunDirectory, RunRecords, Standing, fact},
    settings::{Need, Settings},
    window::WindowRecord,
};
use serde_json::{Map, json};
use tokio::{
    sync::{Mutex as AsyncMutex, OnceCell},
    time::{Instant, sleep},
};

use self::environment::JobEnvironment;
pub use self::probe::{ENGINE, ProbedNode};
use super::{
    Availability, Environment, EnvironmentRequest, Leftover, Provider, ProviderError, ShellRequest, backoff,
    detached::{AgentClient, DIRECTORY},
    docker::{self, DockerSettings},
    time_limit::{self, TimeLimit},
};
use crate::{
    batch::{Cluster, Clusters, FittingNodes, Job, JobOwner, JobRequest},
    host::{
        Host, Program, SlurmNodes,
        slurm::{self, JobPrograms},
    },
};

/// The kind of what the batch system has of an environment.
const JOB: &str = "job";
/// How long a job may take to go once it was taken back: the batch system waits for its processes.
const GONE_WITHIN: Duration = Duration::from_secs(120);
/// What was seen of the queue so long ago is as good as now.
const JUST_NOW: Duration = Duration::from_secs(1);
/// How long a job that only looks may wait for a node.
const PROBED_WITHIN: Duration = Duration::from_secs(600);
/// How often that is looked at, at most: at first more often.
const GONE_YET: Duration = Duration::from_secs(2);

impl Memory {
    /// The job whose end the next one waits for, so that no more than `at_once` run at the same time.
    fn before_the_next(&self, at_once: usize) -> Option<&String> {
        self.submitted.get(self.submitted.len().checked_sub(at_once)?)
    }

    fn submit(&mut self, job: String, at_once: usize) {
        self.submitted.push_back(job);
        let surplus = self.submitted.len().saturating_sub(at_once);
        self.submitted.drain(..surplus);
    }
}

/// What the workload of a job is on its node.
#[derive(Debug, Clone, PartialEq)]
pub enum JobWorkload {
    /// A process.
    Process,
    /// The main process of a container of the node's engine.
    Container(Box<DockerSettings>),
}

impl JobWorkload {
    fn container(&self, request: &EnvironmentRequest) -> Result<Option<JobContainer>, ProviderError> {
        match self {
            Self::Process => Ok(None),
            Self::Container(settings) => docker::job_container(request, settings).map(Some),
        }
    }
}

/// The nodes of a cluster that a host stands for.
pub struct Jobs {
    provider: &'static str,
    workload: JobWorkload,
    host: Arc<dyn Host>,
    nodes: SlurmNodes,
    agent: Arc<AgentClient>,
    cluster: Arc<Cluster>,
    programs: OnceCell<JobPrograms>,
    version: OnceCell<String>,
    longest_minutes: OnceCell<Option<u32>>,
    /// The one node of a run whose nodes are to be one.
    node: AsyncMutex<Option<String>>,
    memory: Arc<Mutex<Memory>>,
}

/// What was learnt while this process lives.
#[derive(Debug, Default)]
struct Memory {
    /// The last jobs, in the order in which they were submitted.
    submitted: VecDeque<String>,
    /// Nodes that failed while they measured.
    lost: BTreeSet<String>,
}

impl Jobs {
    /// Of the provider of that name, on a host that stands for nodes.
    #[must_use]
    pub fn new(
        provider: &'static str,
        workload: JobWorkload,
        host: &Arc<dyn Host>,
        nodes: &SlurmNodes,
        clusters: &Clusters,
    ) -> Self {
        Self::on(provider, workload, host, nodes, clusters.of(&nodes.slurm, host))
    }

    fn on(
        provider: &'static str,
        workload: JobWorkload,
        host: &Arc<dyn Host>,
        nodes: &SlurmNodes,
        cluster: Arc<Cluster>,
    ) -> Self {
        Self {
            provider,
            workload,
            host: Arc::clone(host),
            nodes: nodes.clone(),
            agent: Arc::new(AgentClient::new(Arc::clone(host))),
            cluster,
            programs: OnceCell::new(),
            version: OnceCell::new(),
            longest_minutes: OnceCell::new(),
            node: AsyncMutex::default(),
            memory: Arc::default(),
        }
    }

    async fn programs(&self) -> Result<&JobPrograms, ProviderError> {
        let install = || slurm::install(self.host.as_ref(), &self.nodes);
        Ok(self.programs.get_or_try_init(install).await?)
    }

    /// What a job may ask for at most, in minutes.
    async fn longest_minutes(&self) -> Result<Option<u32>, ProviderError> {
        let ask = || self.cluster.system.longest_minutes(&self.nodes.slurm);
        Ok(*self.longest_minutes.get_or_try_init(ask).await?)
    }

    async fn version(&self) -> Result<&String, ProviderError> {
        self.version
            .get_or_try_init(|| self.cluster.system.version())
            .await
    }

    async fn job_request(&self, request: &EnvironmentRequest) -> Result<JobRequest, ProviderError> {
        let programs = self.programs().await?;
        let deployed = self.agent.deployed().await?;
        let longest = self.longest_minutes().await?;
        let folder = deployed.environments.join(&request.environment);
        Ok(JobRequest {
            name: request.environment.clone(),
            owner: JobOwner {
                run: request.run.clone(),
                host: request.host.clone(),
                scenario: request.scenario.clone(),
            },
            script: programs.script.clone(),
            arguments: [
                programs.workload.as_os_str(),
                deployed.environments.as_os_str(),
                request.environment.as_ref(),
                self.nodes.hardware.as_ref(),
                self.nodes.os.as_ref(),
                deployed.lease.as_os_str(),
            ]
            .map(Into::into)
            .into(),
            output: folder.join(layout::JOB_OUTPUT),
            minutes: time_limit::minutes(&request.settings, request.windows.len(), longest.map(TimeLimit)),
            ..self.any_job().await?
        })
    }

    /// An environment to ask about.
    fn any_environment(&self) -> EnvironmentRequest {
        EnvironmentRequest {
            environment: "matrix-plan".to_owned(),
            run: "plan".to_owned(),
            run_directory: "/".into(),
            scenario: "any".to_owned(),
            host: self.agent.host().to_owned(),
            settings: Settings::default(),
            windows: Vec::new(),
            files: None,
        }
    }

    /// A job that nothing but the cluster stands in the way of, to ask about.
    async fn any_job(&self) -> Result<JobRequest, ProviderError> {
        let longest = self.longest_minutes().await?;
        Ok(JobRequest {
            name: "matrix-plan".to_owned(),
            owner: JobOwner {
                run: "plan".to_owned(),
                host: self.agent.host().to_owned(),
                scenario: "any".to_owned(),
            },
            wishes: self.nodes.slurm.clone(),
            script: "/".into(),
            arguments: Vec::new(),
            output: "/dev/null".into(),
            minutes: longest.unwrap_or(10).min(10),
            after: None,
            node: None,
            not_on: BTreeSet::new(),
        })
    }

    /// The nodes that the host stands for.
    ///
    /// # Errors
    /// When the cluster cannot be asked, or refuses what is wanted of it.
    pub async fn fitting_nodes(&self) -> Result<FittingNodes, ProviderError> {
        self.cluster.system.nodes(&self.any_job().await?).await
    }

    /// What a node is and whether it has what a need asks for, looked at in a job of its own.
    ///
    /// # Errors
    /// When the job does not begin within ten minutes, or does not answer as agreed.
    pub async fn probe(&self, need: &Need) -> Result<ProbedNode, ProviderError> {
        let programs = self.programs().await?;
        let folder = &self.agent.deployed().await?.environments;
        slurm::make_folder(self.host.as_ref(), folder).await?;
        let name = format!("matrix-probe-{}-{}", std::process::id(), self.agent.host());
        let output = folder.join(format!("{name}.txt"));
        let settings = Check::of(&need.settings()).settings;
        let job = JobRequest {
            name: name.clone(),
            script: programs.probe.clone(),
            arguments: vec![
                programs.workload.clone().into_os_string(),
                settings.into(),
                folder.clone().into_os_string(),
            ],
            output: output.clone(),
            minutes: 1,
            ..self.any_job().await?
        };
        self.cluster.system.submit(&job).await?;
        let begun = Instant::now();
        let mut seen = begun;
        loop {
            let snapshot = self
                .cluster
                .queue
                .after(seen, self.nodes.slurm.poll.duration())
                .await;
            seen = snapshot.asked;
            match snapshot.job(&name) {
                Some(job) if job.standing.is_alive() && begun.elapsed() > PROBED_WITHIN => {
                    let reason = job.reason.clone().unwrap_or_else(|| job.state.clone());
                    self.end(&name).await?;
                    return Err(ProviderError::Refused {
                        platform: format!("the batch system of host `{}`", self.agent.host()),
                        action: format!("starting a job within {} min", PROBED_WITHIN.as_secs() / 60),
                        hint: Some("ask again when its nodes are less busy".to_owned()),
                        source: reason.into(),
                    });
                }
                Some(job) if job.standing.is_alive() => {}
                None if snapshot.silence.is_some() => {}
                _ => break,
            }
        }
        sleep(self.nodes.slurm.visible_within.duration()).await;
        let printed = slurm::take_file(self.host.as_ref(), &output).await?;
        probe::answer(&printed)
    }

    /// The one node on which a run measures all scenarios of this host: where it has measured, or is to measure, or else where a job
    /// would run soonest. None where any node will do.
    async fn one_node(
        &self,
        request: &EnvironmentRequest,
        job: &JobRequest,
    ) -> Result<Option<String>, ProviderError> {
        if self.nodes.slurm.nodes != Nodes::One {
            return Ok(None);
        }
        let lost = self.remembered().lost.clone();
        let can = |node: &String| !lost.contains(node);
        let mut chosen = self.node.lock().await;
        if let Some(node) = chosen.clone().filter(can) {
            return Ok(Some(node));
        }
        let is_of_run = |job: &&Job| {
            let owner = job.owner.as_ref();
            job.standing.is_alive()
                && owner.is_some_and(|owner| (&owner.run, &owner.host) == (&request.run, &request.host))
        };
        let queue = self.cluster.queue.now().await?;
        let mut queued = queue
            .iter()
            .filter(is_of_run)
            .filter_map(|job| job.wanted_node.clone());
        *chosen = match queued.find(can).or_else(|| measured_on(request).filter(can)) {
            Some(node) => Some(node),
            None => {
                let job = JobRequest {
                    not_on: lost.clone(),
                    ..job.clone()
                };
                self.cluster.system.forecast(&job).await?.node
            }
        };
        Ok(chosen.clone())
    }

    /// Where the file means one node and no other, nothing is measured elsewhere when that one fails.
    fn ensure_a_node_is_left(&self) -> Result<(), ProviderError> {
        let only = self.nodes.slurm.nodelist.as_ref();
        match only.filter(|node| self.remembered().lost.contains(*node)) {
            None => Ok(()),
            Some(node) => Err(ProviderError::Unreachable {
                platform: format!("node `{node}` of host `{}`", self.agent.host()),
                hint: Some("see what `sinfo -R` prints of it; `matrix resume` measures what is missing when it is back".to_owned()),
                source: "it failed, or was taken away, while it measured".into(),
            }),
        }
    }

    fn at_once(&self) -> usize {
        usize::try_from(self.nodes.slurm.at_once.max(1)).unwrap_or(1)
    }

    fn remembered(&self) -> std::sync::MutexGuard<'_, Memory> {
        // It is whole whenever the lock is free, also after a panic.
        self.memory.lock().unwrap_or_else(PoisonError::into_inner)
    }

    async fn environment(
        &self,
        request: &EnvironmentRequest,
        job: JobStanding,
    ) -> Result<Box<dyn Environment>, ProviderError> {
        let mut facts = Map::from_iter([
            (fact::PROVIDER.to_owned(), json!(self.provider)),
            (
                fact::WORKLOAD_SHA256.to_owned(),
                json!(self.programs().await?.workload_sha256),
            ),
            (fact::BATCH_SYSTEM.to_owned(), json!(self.version().await?)),
            (fact::JOB_WISHES.to_owned(), json!(self.nodes.slurm.wishes())),
            (fact::JOB.to_owned(), json!(job.job)),
        ]);
        if let JobWorkload::Container(settings) = &self.workload {
            facts.insert("limits".to_owned(), json!(settings));
        }
        Ok(Box::new(JobEnvironment::new(
            environment::Parts {
                agent: Arc::clone(&self.agent),
                cluster: Arc::clone(&self.cluster),
                slurm: self.nodes.slurm.clone(),
                memory: Arc::clone(&self.memory),
            },
            request,
            facts,
            job,
        )))
    }

    /// The folders of this provider, of whichever host on this file system. What has no owner on record is `native`'s to remove.
    async fn listed(&self) -> Result<Vec<ListedEnvironment>, ProviderError> {
        let listed = self.agent.list().await?.environments;
        let is_ours = |it: &ListedEnvironment| match &it.owner {
            Some(owner) => owner.provider == self.provider,
            None => self.provider == NATIVE,
        };
        Ok(listed.into_iter().filter(is_ours).collect())
    }

    /// Takes a job back and waits until it is gone: what it runs writes to the folder until then.
    async fn end(&self, name: &str) -> Result<(), ProviderError> {
        end(&self.cluster, name).await
    }
}

/// Takes the jobs of that name back and waits until they are gone.
async fn end(cluster: &Cluster, name: &str) -> Result<(), ProviderError> {
    let begun = Instant::now();
    let mut pause = GONE_YET / 20;
    loop {
        let jobs = backoff::retried(|| cluster.queue.now()).await?;
        let alive: Vec<&Job> = jobs
            .iter()
            .filter(|job| job.name == name && job.standing.is_alive())
            .collect();
        if alive.is_empty() {
            return Ok(());
        }
        if begun.elapsed() > GONE_WITHIN {
            return Err(ProviderError::TimedOut {
                action: format!("taking the job {name} back"),
                after: GONE_WITHIN,
            });
        }
        for job in alive {
            backoff::retried(|| cluster.system.cancel(&job.id)).await?;
        }
        sleep(pause).await;
        pause = (pause * 2).min(GONE_YET);
    }
}

fn resource(host: &str, kind: &str, name: &str) -> Resource {
    Resource {
        host: host.to_owned(),
        kind: kind.to_owned(),
        name: name.to_owned(),
    }
}

/// The node of an environment of this run and host that was collected.
fn measured_on(request: &EnvironmentRequest) -> Option<String> {
    let directory = RunDirectory::new(request.run_directory.clone());
    let plan = RunRecords::read(&directory).ok()?.plan;
    plan.scenarios.iter().find_map(|planned| {
        let text = directory
            .environment(&planned.slug)
            .read(WindowRecord::MOST_BYTES)
            .ok()?;
        let record: EnvironmentRecord = serde_json::from_slice(&text).ok()?;
        let is_here = record.host == request.host;
        let node = record.facts.get(fact::NODE).filter(|_| is_here)?;
        node.as_str().map(str::to_owned)
    })
}

#[async_trait]
impl Provider for Jobs {
    fn name(&self) -> &'static str {
        self.provider
    }

    async fn survey(&self) -> Availability {
        let asking = async {
            let version = self.version().await?;
            let forecast = self.cluster.system.forecast(&self.any_job().await?).await?;
            // Whether there is a workload for the nodes is known before anything is submitted.
            self.programs().await?;
            // Whether its node has an engine is known to nobody before a job runs there.
            self.workload.container(&self.any_environment())?;
            Ok::<_, ProviderError>(match (forecast.node, forecast.start) {
                (Some(node), Some(start)) => format!("{version}, a job would start at {start} on {node}"),
                (_, Some(start)) => format!("{version}, a job would start at {start}"),
                _ => version.clone(),
            })
        };
        match asking.await {
            Ok(detail) => Availability::Available { detail },
            Err(error) => Availability::prevented_by(error),
        }
    }

    async fn survey_need(&self, need: &Need) -> Option<Availability> {
        match &self.workload {
            JobWorkload::Process => None,
            JobWorkload::Container(settings) => match settings.base() {
                Ok(base) => docker::lacking(base, need),
                Err(error) => Some(Availability::prevented_by(error)),
            },
        }
    }

    fn resources(&self, request: &EnvironmentRequest) -> Vec<Resource> {
        [DIRECTORY, JOB]
            .map(|kind| resource(&request.host, kind, &request.environment))
            .into()
    }

    async fn create(&self, request: &EnvironmentRequest) -> Result<Box<dyn Environment>, ProviderError> {
        self.ensure_a_node_is_left()?;
        let mut job = self.job_request(request).await?;
        job.node = self.one_node(request, &job).await?;
        {
            let memory = self.remembered();
            job.after = memory.before_the_next(self.at_once()).cloned();
            job.not_on.clone_from(&memory.lost);
        }
        let container = self.workload.container(request)?;
        self.agent.prepare(self.provider, request, container).await?;
        let number = self.cluster.system.submit(&job).await?;
        self.remembered().submit(number.clone(), self.at_once());
        let job = JobStanding {
            job: number,
            standing: Standing::Waits,
            state: "PENDING".to_owned(),
            reason: None,
            node: None,
            start: None,
        };
        self.environment(request, job).await
    }

    async fn find(
        &self,
        request: &EnvironmentRequest,
    ) -> Result<Option<Box<dyn Environment>>, ProviderError> {
        let name = &request.environment;
        // Whoever asks goes on waiting for jobs anyway: one question for all that are looked for.
        let asked = Instant::now().checked_sub(JUST_NOW).unwrap_or_else(Instant::now);
        let seen = self.cluster.queue.after(asked, Duration::ZERO).await;
        let job = seen.job(name);
        // What it said before it fell silent may have been before the job was taken back.
        if let Some(silence) = &seen.silence {
            return Err(ProviderError::Unreachable {
                platform: format!("the batch system of host `{}`", self.agent.host()),
                hint: Some("wait until it answers: its jobs go on without it".to_owned()),
                source: silence.clone().into(),
            });
        }
        if let Some(job) = job.filter(|job| job.standing.is_alive()) {
            self.remembered().submit(job.id.clone(), self.at_once());
            return self.environment(request, job.standing()).await.map(Some);
        }
        let is_it = |it: &ListedEnvironment| it.environment == *name;
        if !self.agent.list().await?.environments.iter().any(is_it) {
            return Ok(None);
        }
        let (looked, _) = self.agent.look(name, 0).await?;
        let forgotten = looked.job.map(|job| JobStanding {
            job: job.job,
            standing: Standing::Ended,
            state: "not in the queue any more".to_owned(),
            reason: None,
            node: Some(job.node),
            start: None,
        });
        match job.map(Job::standing).or(forgotten) {
            Some(job) => self.environment(request, job).await.map(Some),
            // It was prepared and never submitted, or its job never began and is forgotten: there is nothing in it.
            None => Ok(None),
        }
    }

    async fn shell(&self, request: &ShellRequest<'_>) -> Result<Program, ProviderError> {
        request.in_no_network(self.provider)?;
        request.of_no_image(self.provider)?;
        let environment = request.environment;
        let (looked, _) = self.agent.look(environment, 0).await?;
        let jobs = self.cluster.queue.now().await?;
        let job = jobs
            .iter()
            .find(|job| job.name == environment && job.standing.is_alive());
        match job.filter(|_| looked.job.is_some()) {
            Some(job) => Ok(self.cluster.system.shell(&job.id)),
            None => Err(ProviderError::NotFound {
                what: format!("a running job of {environment}"),
            }),
        }
    }

    async fn time_limit(&self) -> Result<Option<TimeLimit>, ProviderError> {
        Ok(self.longest_minutes().await?.map(TimeLimit))
    }

    async fn leftovers(&self) -> Result<Vec<Leftover>, ProviderError> {
        let jobs = self.cluster.queue.now().await?;
        let alive = |name: &str| {
            jobs.iter()
                .find(|job| job.name == name && job.standing.is_alive())
        };
        let listed = self.listed().await?;
        // By the host's own name, so that what two hosts of a cluster list is one.
        let host = |it: &ListedEnvironment| {
            let owner = it.owner.as_ref();
            owner.map_or_else(|| self.agent.host().to_owned(), |owner| owner.host.clone())
        };
        let folders = listed.iter().map(|it| Leftover {
            resource: resource(&host(it), DIRECTORY, &it.environment),
            run: it.owner.as_ref().map(|owner| owner.run.clone()),
            run_directory: it.owner.as_ref().map(|owner| owner.run_directory.clone()),
            scenario: it.owner.as_ref().map(|owner| owner.scenario.clone()),
            running: alive(&it.environment).is_some(),
            job: alive(&it.environment).map(|job| job.id.clone()),
        });
        // A job whose folder is gone is ours by its name and its comment.
        let is_listed = |name: &str| listed.iter().any(|it| it.environment == name);
        let without = jobs
            .iter()
            .filter(|job| job.standing.is_alive() && !is_listed(&job.name));
        let without = without.filter_map(|job| {
            let owner = job.owner.as_ref().filter(|_| self.provider == NATIVE)?;
            Some(Leftover {
                resource: resource(&owner.host, JOB, &job.name),
                run: Some(owner.run.clone()),
                run_directory: None,
                scenario: Some(owner.scenario.clone()),
                running: true,
                job: Some(job.id.clone()),
            })
        });
        Ok(folders.chain(without).collect())
    }

    async fn remove(&self, leftover: &Leftover) -> Result<(), ProviderError> {
        let name = &leftover.resource.name;
        self.end(name).await?;
        self.cluster.queue.outdate();
        self.agent.remove(name).await.map(drop)
    }
}

#[cfg(test)]
mod tests;
