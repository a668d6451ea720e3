//! What hosts, programs and people really write, for parsers of text.

use std::{fs, path::Path};

use serde_json::json;

/// A file of the project.
fn project(path: &str) -> Vec<u8> {
    let root = Path::new(env!("CARGO_MANIFEST_DIR")).join("../..");
    fs::read(root.join(path)).expect("it is in the project")
}

fn texts<const N: usize>(texts: [&str; N]) -> Vec<Vec<u8>> {
    texts.map(|text| text.as_bytes().to_vec()).into()
}

pub fn matrix_files() -> Vec<Vec<u8>> {
    let mut files = ["matrix.yaml", "examples/paper.yaml", "examples/sweep.yaml"]
        .map(project)
        .to_vec();
    files.extend(texts([
        "matrix:\n  virtualization: [native, docker]\n  exclude: [{virtualization: docker, host: here}]\n\
         hosts:\n  here: {hardware: a, os: b, connect: local}\n  there: {hardware: a, os: b, connect: {ssh: me@there}}\n",
        "matrix:\n  virtualization: [fake]\n  network.delay: [1ms, 2ms]\n  include: [{virtualization: fake, network.delay: 3ms}]\n\
         profiles:\n  quick: {workload: {windows: 2}}\nreport: {alpha: 0.01}\n",
    ]));
    files
}

pub fn platforms() -> Vec<Vec<u8>> {
    [
        "arm64-ubuntu-docker",
        "arm64-ubuntu-native",
        "intel-i7-osx-virtualbox",
    ]
    .map(|name| project(&format!("examples/paper-platforms/{name}.yaml")))
    .to_vec()
}

pub fn slurm() -> Vec<Vec<u8>> {
    texts([
        "17|RUNNING|None|n1|n1|2026-11-27T14:00:00|matrix-r-native-1|matrix run=r host=h scenario=native\n\
         18|PENDING|BadConstraints||(null)|N/A|matrix-r-docker-2|matrix run=r host=h scenario=docker | more\n",
        "n1|debug*|idle*\nn2|long|mixed\nn3|debug*|down$\n",
        "debug*|2-12:00:00\nlong|infinite\nshort|30:00\n",
        "sbatch: Job 5 to start at 2026-01-31T00:00:00 using 2 processors on nodes n3 in partition lab",
        "17;cluster",
        "sbatch: error: Batch job submission failed: Requested node configuration is not available",
    ])
}

pub fn drift_files() -> Vec<Vec<u8>> {
    texts([
        "acknowledged:\n- since: 2027-01-01\n  scenario: x86-64-debian-12-docker\n  reason: a new kernel\n",
        "acknowledged:\n- {since: '2027-01-01', scenario: '*', metrics: [error], reason: r, baseline: keep}\n",
    ])
}

pub fn progress() -> Vec<Vec<u8>> {
    texts([
        "{\"event\":\"started\",\"pid\":7}\n{\"event\":\"network-up\"}\n{\"event\":\"connected\"}\n\
         {\"event\":\"measuring\",\"window\":1}\n{\"event\":\"window-complete\",\"window\":1,\"verdict\":\"valid\"}\n{\"event\":\"finished\"}\n",
        "{\"event\":\"health\",\"window\":1,\"steps_done\":5,\"steps_expected\":9,\"missed_deadlines\":0,\"worst_lateness_ns\":-3}\n\
         {\"event\":\"failed\",\"reason\":\"r\",\"hint\":null,\"platform\":true}\n",
        "{\"event\":\"notice\",\"host\":\"h1\",\"text\":\"a \\t\\u001b]0;b\"}\n\
         {\"event\":\"platform-changed\",\"changes\":[{\"field\":\"kernel\",\"before\":\"6\",\"after\":7}]}\n",
    ])
}

pub fn answers() -> Vec<Vec<u8>> {
    let owner = json!({
        "provider": "native", "run": "r", "run_directory": "/runs/r", "scenario": "s", "host": "here", "windows": [1, 2],
    });
    [
        json!({"pid": 7}),
        json!({"running": false, "ended": {"code": 0}, "last_words": "bye"}),
        json!({"asked": true}),
        json!({"removed": true}),
        json!({
            "environments": [{"environment": "e", "owner": owner, "started": true, "running": false}],
            "bridges": ["mx00000001"],
        }),
        json!({"free_bytes": 1, "platform": {"format": 1, "machine": "x86_64", "os": "debian-12"}}),
        json!({"failure": "not-found", "message": "m", "hint": "h"}),
        json!({"lease": "held", "held": {"pid": 1, "machine": "m", "run_directory": "/r", "since": "2026-01-01T00:00:00Z"}}),
        json!({
            "format": 1, "workload_version": "0.1.0", "can_run": false,
            "checks": [{"name": "tun", "required": true, "available": false, "reason": "r", "fix": "f"}],
        }),
    ]
    .map(|answer| answer.to_string().into_bytes())
    .into()
}

pub fn ssh_configurations() -> Vec<Vec<u8>> {
    texts([
        "user me\nhostname there\nport 22\nidentityfile ~/.ssh/id_ed25519\nuserknownhostsfile ~/.ssh/known_hosts ~/.ssh/known_hosts2\n\
         globalknownhostsfile /etc/ssh/ssh_known_hosts\nidentityagent SSH_AUTH_SOCK\nproxyjump a,b:22\nhostkeyalias none\nproxycommand none\n",
    ])
}

pub fn vagrant() -> Vec<Vec<u8>> {
    texts([
        "1700000000,machine,metadata,provider,libvirt\n1700000000,machine,state,running\n\
         1700000001,machine,error-exit,Vagrant::Errors::VMBootBadState,a%!(VAGRANT_COMMA) b\\n\n1700000002,,ui,error,oh\n",
        "Host machine\n  HostName 192.168.121.237\n  User vagrant\n  Port 22\n  IdentityFile \"/a b/private_key\"\n",
    ])
}

pub fn xml_rpc() -> Vec<Vec<u8>> {
    texts([
        "<?xml version='1.0'?>\n<methodCall>\n<methodName>registerPublisher</methodName>\n<params>\n\
         <param><value><string>/plant</string></value></param>\n<param><value>/state</value></param>\n</params></methodCall>",
        "<?xml version='1.0'?><methodResponse><params><param><value><array><data><value><int>1</int></value>\
         <value><string>ok</string></value><value><array><data><value><i4>-5</i4></value><value><boolean>1</boolean></value>\
         <value><double>0.5</double></value></data></array></value></data></array></value></param></params></methodResponse>",
        "<methodResponse><fault><value><struct><member><name>faultCode</name><value><int>4</int></value></member>\
         <member><name>faultString</name><value>a &lt; b</value></member></struct></value></fault></methodResponse>",
    ])
}

pub fn http() -> Vec<Vec<u8>> {
    texts([
        "POST /RPC2 HTTP/1.1\r\nHost: 10.0.0.1:11311\r\nContent-Type: text/xml\r\nContent-Length: 4\r\n\r\n<a/>",
        "HTTP/1.0 200 OK\r\nServer: BaseHTTP/0.6\r\nConnection: close\r\nContent-length: 4\r\n\r\n<a/>",
        "HTTP/1.1 200 OK\r\n\r\n<a/>",
    ])
}

pub fn tcpros() -> Vec<Vec<u8>> {
    let frame = |content: &[u8]| {
        let mut frame = u32::try_from(content.len())
            .unwrap_or_default()
            .to_le_bytes()
            .to_vec();
        frame.extend_from_slice(content);
        frame
    };
    let header: Vec<u8> = [
        "callerid=/controller",
        "topic=/state",
        "md5sum=*",
        "type=std_msgs/String",
    ]
    .iter()
    .flat_map(|field| frame(field.as_bytes()))
    .collect();
    let mut connection = frame(&header);
    connection.extend(frame(&frame(b"1 2.0 3.0")));
    // An array of six without names of dimensions.
    let mut array = vec![0; 8];
    array.extend(6_u32.to_le_bytes());
    array.extend([0; 48]);
    vec![connection, frame(&array)]
}

pub fn messages() -> Vec<Vec<u8>> {
    texts(["0.1234 -0.5 0.0 1.0 2.0 3.0", "1.5000,-2.2500", "1 2 3 4"])
}
