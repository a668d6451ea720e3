//! Jobs of a batch system that is none: what it is asked and what it answers are a test's. The workload is real, and computes.

use std::{
    path::Path,
    process::{Child, Command, Stdio},
};

use record::{
    connection::Slurm,
    run_directory::JobStanding,
    settings::{Dynamics, SimulationSettings},
};
use tempfile::TempDir;

use super::*;
use crate::{
    batch::{BatchSystem, FittingNodes, Forecast},
    host::{Here, slurm::SlurmHost},
    provider::{Ended, News},
    state_directory::StateDirectory,
};

/// What the batch system does with the next job.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
enum Fate {
    /// Runs it.
    Runs,
    /// Keeps it in the queue.
    Waits,
    /// Takes its node away before it begins.
    LosesItsNode,
    /// Refuses it.
    Refuses,
}

/// A batch system of one node. It is strict: a name is submitted once, a job's output has its folder, and what it does not know cannot
/// be asked to end.
struct FakeBatch {
    fate: Mutex<Fate>,
    jobs: Mutex<Vec<(JobRequest, Job, Option<Child>)>>,
    questions: Mutex<usize>,
}

impl FakeBatch {
    fn with(fate: Fate) -> Arc<Self> {
        Arc::new(Self {
            fate: Mutex::new(fate),
            jobs: Mutex::default(),
            questions: Mutex::default(),
        })
    }

    fn requests(&self) -> Vec<JobRequest> {
        let jobs = self.jobs.lock().unwrap();
        jobs.iter().map(|(request, ..)| request.clone()).collect()
    }

    /// The cluster forgets all jobs, once they are over.
    fn forget(&self) {
        for (_, job, child) in self.jobs.lock().unwrap().iter_mut() {
            if let Some(child) = child {
                child.wait().unwrap();
                job.standing = Standing::Ended;
            }
        }
        self.jobs
            .lock()
            .unwrap()
            .retain(|(_, job, _)| job.standing.is_alive());
    }
}

#[async_trait]
impl BatchSystem for FakeBatch {
    async fn version(&self) -> Result<String, ProviderError> {
        Ok("Fake 1".to_owned())
    }

    async fn forecast(&self, job: &JobRequest) -> Result<Forecast, ProviderError> {
        let node = ["n1", "n2"].into_iter().find(|node| !job.not_on.contains(*node));
        Ok(Forecast {
            start: None,
            node: node.map(str::to_owned),
        })
    }

    async fn nodes(&self, _: &JobRequest) -> Result<FittingNodes, ProviderError> {
        Ok(FittingNodes {
            fit: ["n1", "n2"].map(str::to_owned).into(),
            out_of_service: Vec::new(),
        })
    }

    async fn longest_minutes(&self, _: &Slurm) -> Result<Option<u32>, ProviderError> {
        Ok(None)
    }

    async fn submit(&self, request: &JobRequest) -> Result<String, ProviderError> {
        let mut jobs = self.jobs.lock().unwrap();
        assert!(
            jobs.iter().all(|(other, ..)| other.name != request.name),
            "{} is submitted twice",
            request.name
        );
        assert!(request.output.parent().is_some_and(Path::is_dir), "{request:?}");
        let fate = *self.fate.lock().unwrap();
        if fate == Fate::Refuses {
            return Err(ProviderError::OutOfOrder { reason: "no" });
        }
        let id = (jobs.len() + 1).to_string();
        let node = request.node.clone().unwrap_or_else(|| "n1".to_owned());
        let standing = match fate {
            Fate::Runs => Standing::Runs,
            Fate::LosesItsNode => Standing::LostItsNode,
            Fate::Waits | Fate::Refuses => Standing::Waits,
        };
        let child = (standing == Standing::Runs).then(|| {
            let mut script = Command::new("sh");
            script
                .arg(&request.script)
                .args(&request.arguments)
                .env("SLURM_JOB_ID", &id)
                .env("SLURMD_NODENAME", &node)
                .stdin(Stdio::null())
                .stdout(std::fs::File::create(&request.output).unwrap())
                .stderr(Stdio::null());
            crate::workload_binary::start(|| script.spawn()).unwrap()
        });
        let job = Job {
            id: id.clone(),
            name: request.name.clone(),
            owner: Some(request.owner.clone()),
            standing,
            state: format!("{standing:?}"),
            reason: None,
            node: Some(node.clone()),
            wanted_node: request.node.clone(),
            start: None,
        };
        jobs.push((request.clone(), job, child));
        Ok(id)
    }

    async fn jobs(&self) -> Result<Vec<Job>, ProviderError> {
        *self.questions.lock().unwrap() += 1;
        let mut jobs = self.jobs.lock().unwrap();
        for (_, job, child) in jobs.iter_mut() {
            let has_ended = child
                .as_mut()
                .is_some_and(|child| child.try_wait().unwrap().is_some());
            if has_ended && job.standing == Standing::Runs {
                job.standing = Standing::Ended;
                job.state = "COMPLETED".to_owned();
            }
        }
        Ok(jobs.iter().map(|(_, job, _)| job.clone()).collect())
    }

    async fn stop(&self, id: &str) -> Result<(), ProviderError> {
        self.cancel(id).await
    }

    async fn cancel(&self, id: &str) -> Result<(), ProviderError> {
        let mut jobs = self.jobs.lock().unwrap();
        let found = jobs.iter_mut().find(|(_, job, _)| job.id == id);
        let (_, job, child) = found.expect("a job that was submitted");
        if let Some(child) = child {
            let _ = child.kill();
            let _ = child.wait();
        }
        if job.standing.is_alive() {
            job.standing = Standing::Ended;
            job.state = "CANCELLED".to_owned();
        }
        Ok(())
    }

    fn shell(&self, job: &str) -> Program {
        Program::new("true", [job])
    }
}

/// A cluster whose shared file system is a folder of the test's.
struct Place {
    folder: TempDir,
    system: Arc<FakeBatch>,
    jobs: Jobs,
}

impl Place {
    fn with(fate: Fate) -> Self {
        Self::of(fate, Slurm::default())
    }

    fn of(fate: Fate, slurm: Slurm) -> Self {
        Self::at(tempfile::tempdir().unwrap(), FakeBatch::with(fate), slurm)
    }

    /// As another `matrix` finds it, which has seen nothing of the queue yet.
    fn again(self) -> Self {
        Self::at(self.folder, self.system, Slurm::default())
    }

    fn at(folder: TempDir, system: Arc<FakeBatch>, slurm: Slurm) -> Self {
        let state = StateDirectory::new(folder.path());
        let nodes = SlurmNodes {
            slurm: Slurm {
                poll: record::quantity::TimeSpan::from_millis(10),
                visible_within: record::quantity::TimeSpan::from_millis(10),
                ..slurm
            },
            hardware: "mine".to_owned(),
            os: "any".to_owned(),
        };
        let submit: Arc<dyn Host> = Arc::new(Here::new("lab", state.clone()));
        let host: Arc<dyn Host> = Arc::new(SlurmHost::new("lab", submit, nodes.clone(), state));
        let cluster = Arc::new(Cluster::new(Arc::clone(&system) as Arc<dyn BatchSystem>));
        Self {
            jobs: Jobs::on("simulated", JobWorkload::Process, &host, &nodes, cluster),
            folder,
            system,
        }
    }

    fn request(&self, attempt: u32) -> EnvironmentRequest {
        EnvironmentRequest {
            environment: format!("matrix-r-s-{attempt}"),
            run: "r".to_owned(),
            run_directory: self.folder.path().join("r"),
            scenario: "s".to_owned(),
            host: "lab".to_owned(),
            settings: Settings {
                simulation: Some(SimulationSettings::default()),
                windows: 1,
                // One period: what is computed matters to none of these tests.
                window: record::quantity::TimeSpan::from_secs(100),
                ..Settings::of(Dynamics::default())
            },
            windows: vec![1],
            files: None,
        }
    }
}

async fn to_the_end(environment: &mut Box<dyn Environment>) -> (Vec<JobStanding>, Ended) {
    let mut jobs = Vec::new();
    while let Some(news) = environment.next_news().await.unwrap() {
        if let News::Job(job) = news {
            jobs.push(job);
        }
    }
    (jobs, environment.ended().await.unwrap())
}

#[tokio::test]
async fn a_job_computes_is_collected_and_nothing_is_left() {
    let place = Place::with(Fate::Runs);
    let request = place.request(1);
    let mut environment = place.jobs.create(&request).await.unwrap();
    let (jobs, ended) = to_the_end(&mut environment).await;
    assert!(ended.success, "{ended:?}");
    assert!(jobs.iter().all(|job| job.job == "1"), "{jobs:?}");
    let facts = environment.facts();
    assert_eq!((&facts["job"], &facts["node"]), (&json!("1"), &json!("n1")));
    let collected = place.folder.path().join("collected");
    std::fs::create_dir(&collected).unwrap();
    environment.collect(&collected).await.unwrap();
    assert!(collected.join("window-1/window.json").is_file());
    environment.discard().await.unwrap();
    assert_eq!(place.jobs.leftovers().await.unwrap(), []);
    assert!(place.jobs.find(&request).await.unwrap().is_none());
}

#[tokio::test]
async fn a_job_that_was_just_taken_back_is_not_found_again() {
    let place = Place::with(Fate::Waits);
    let request = place.request(1);
    let environment = place.jobs.create(&request).await.unwrap();
    assert!(place.jobs.find(&request).await.unwrap().is_some());
    environment.discard().await.unwrap();
    assert!(place.jobs.find(&request).await.unwrap().is_none());
}

#[tokio::test]
async fn what_a_forgotten_job_left_is_found_and_one_that_never_began_is_nothing() {
    let place = Place::with(Fate::Runs);
    let request = place.request(1);
    let mut environment = place.jobs.create(&request).await.unwrap();
    to_the_end(&mut environment).await;
    drop(environment);
    place.system.forget();
    let place = place.again();
    let mut found = place.jobs.find(&request).await.unwrap().unwrap();
    assert!(!found.running());
    assert!(to_the_end(&mut found).await.1.success);

    *place.system.fate.lock().unwrap() = Fate::Waits;
    let second = place.request(2);
    drop(place.jobs.create(&second).await.unwrap());
    place.system.cancel("1").await.unwrap();
    place.system.forget();
    let place = place.again();
    assert!(place.jobs.find(&second).await.unwrap().is_none());
}

#[tokio::test]
async fn a_job_whose_node_is_gone_says_so_and_the_next_one_goes_elsewhere() {
    let place = Place::with(Fate::LosesItsNode);
    let mut environment = place.jobs.create(&place.request(1)).await.unwrap();
    let (_, ended) = to_the_end(&mut environment).await;
    assert!(ended.lost_its_node, "{ended:?}");
    *place.system.fate.lock().unwrap() = Fate::Runs;
    let mut environment = place.jobs.create(&place.request(2)).await.unwrap();
    assert!(to_the_end(&mut environment).await.1.success);
    let requests = place.system.requests();
    let nodes: Vec<_> = requests.iter().map(|it| it.node.as_deref()).collect();
    assert_eq!(nodes, [Some("n1"), Some("n2")]);
    assert!(requests[1].not_on.contains("n1"));
}

#[tokio::test]
async fn where_one_node_alone_is_meant_nothing_is_measured_elsewhere() {
    let slurm = Slurm {
        nodelist: Some("n1".to_owned()),
        ..Slurm::default()
    };
    let place = Place::of(Fate::LosesItsNode, slurm);
    let mut environment = place.jobs.create(&place.request(1)).await.unwrap();
    assert!(to_the_end(&mut environment).await.1.lost_its_node);
    let refused = place.jobs.create(&place.request(2)).await.err().unwrap();
    assert!(refused.to_string().contains("node `n1`"), "{refused}");
    assert!(refused.hint().unwrap().contains("when it is back"));
    // Nothing of it was made.
    assert_eq!(place.system.requests().len(), 1);
    assert!(place.jobs.find(&place.request(2)).await.unwrap().is_none());
}

#[tokio::test]
async fn jobs_wait_for_each_other_and_as_many_as_are_wished_run_at_once() {
    for (at_once, after) in [(1, [None, Some("1"), Some("2")]), (2, [None, None, Some("1")])] {
        let slurm = Slurm {
            at_once,
            ..Slurm::default()
        };
        let place = Place::of(Fate::Waits, slurm);
        for attempt in 1..=3 {
            drop(place.jobs.create(&place.request(attempt)).await.unwrap());
        }
        let requests = place.system.requests();
        let waits: Vec<_> = requests.iter().map(|it| it.after.as_deref()).collect();
        assert_eq!(waits, after, "{at_once} at once");
    }
}

#[tokio::test]
async fn a_refused_job_leaves_a_folder_that_can_be_removed_and_one_that_waits_is_taken_back() {
    let place = Place::with(Fate::Refuses);
    let request = place.request(1);
    assert!(place.jobs.create(&request).await.is_err());
    assert!(place.jobs.find(&request).await.unwrap().is_none());
    let left = place.jobs.leftovers().await.unwrap();
    assert_eq!(left.len(), 1);
    assert!(!left[0].running);
    place.jobs.remove(&left[0]).await.unwrap();

    *place.system.fate.lock().unwrap() = Fate::Waits;
    drop(place.jobs.create(&place.request(2)).await.unwrap());
    let left = place.jobs.leftovers().await.unwrap();
    assert!(left.iter().any(|it| it.running), "{left:?}");
    place.jobs.remove(&left[0]).await.unwrap();
    assert_eq!(place.jobs.leftovers().await.unwrap(), []);
    assert!(
        place
            .system
            .jobs()
            .await
            .unwrap()
            .iter()
            .all(|job| !job.standing.is_alive())
    );
}

#[tokio::test]
async fn a_hundred_who_wait_ask_the_cluster_once() {
    let place = Place::with(Fate::Waits);
    let queue = &place.jobs.cluster.queue;
    let since = Instant::now();
    let asking = (0..100).map(|_| queue.after(since, Duration::from_secs(3600)));
    futures_util::future::join_all(asking).await;
    assert_eq!(*place.system.questions.lock().unwrap(), 1);
}
