//! Boots the guest and gives a shell in it, with the `matrix` and `workload` binaries in root's folder:
//! `cargo run -p tests --example guest`.

use tests::{Guest, matrix_binary, workload_binary};

fn main() {
    let guest = Guest::boot();
    for binary in [matrix_binary(), workload_binary()] {
        guest.put(binary, "/root/");
    }
    println!("`exit` or Ctrl-D ends the machine and all that is in it");
    let mut shell = guest.shell();
    let status = shell.status().expect("ssh starts");
    println!("the shell ended: {status}");
}
