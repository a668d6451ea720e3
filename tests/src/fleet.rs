//! Machines of three architectures for one matrix: this one, and an aarch64 and an i686 over SSH, emulated and real down to
//! their kernels. The main type is [`Fleet`].

use std::thread;

use crate::{AARCH64, Guest, I686};

/// Two machines beside this one, until it is dropped.
#[derive(Debug)]
pub struct Fleet {
    /// The aarch64 one, `arm` in the matrix.
    pub arm: Guest,
    /// The i686 one, `old` in the matrix.
    pub old: Guest,
}

impl Fleet {
    /// Boots both, at once: much of a boot is done by one processor.
    ///
    /// # Panics
    /// As [`Guest::of`].
    #[must_use]
    pub fn boot() -> Self {
        thread::scope(|scope| {
            let arm = scope.spawn(|| Guest::of(AARCH64));
            let old = Guest::of(I686);
            Self {
                arm: arm.join().expect("the aarch64 one boots"),
                old,
            }
        })
    }

    /// A matrix over all three machines: these virtualizations, as a list of YAML's; `workload` are further lines of its
    /// section, `providers` of that.
    ///
    /// Emulated processors hold 20 control steps a second. libvirt is told to emulate too, as it would take KVM, which
    /// not every machine has.
    #[must_use]
    pub fn matrix(&self, virtualizations: &str, workload: &str, providers: &str) -> String {
        format!(
            "\
hosts:
  here: {{}}
  arm:
    hardware: aarch64
    os: debian-12
    connect: {}
  old:
    hardware: i686
    os: debian-12
    connect: {}
matrix:
  virtualization: {virtualizations}
workload:
  rate: 20Hz
{workload}\
providers:
  libvirt:
    options: {{driver: qemu, cpu_mode: custom, cpu_model: qemu64, graphics_type: none, video_type: none}}
{providers}",
            self.arm.connect(),
            self.old.connect()
        )
    }
}
