"""A network by Mininet's own API: hosts, Open vSwitch switches, an OpenFlow controller, TCLinks.

The workload starts this program and speaks with it in lines of JSON: a request on standard input, an answer on
standard output. The end of standard input is the end of the network, whatever became of the workload. Every name that
it makes on the machine begins with the one in the first request, and each bridge says in OVSDB whose it is.
"""

import json
import os
import shutil
import signal
import socket
import subprocess
import sys

# What was run, as in a shell, each command followed by what it printed.
transcript = []

# What Mininet and this program run. The controller has several names.
PROGRAMS = (
    "mn mnexec ip tc ifconfig ethtool telnet setpriv ovs-vswitchd ovs-vsctl ovs-ofctl ovs-appctl ovs-dpctl".split()
)

# Standard output, of which whatever Mininet or a program prints is kept off.
answers = os.fdopen(os.dup(1), "w")
os.dup2(2, 1)


class Missing(Exception):
    """Something is not installed."""


def say(answer):
    answers.write(json.dumps(answer) + "\n")
    answers.flush()


def record(command, output):
    transcript.append(f"# {command}\n" + output.replace("\r\n", "\n"))


def record_version(*command):
    ran = subprocess.run(command, stdout=subprocess.PIPE, stderr=subprocess.STDOUT, stdin=subprocess.DEVNULL)
    record(" ".join(command), ran.stdout.decode(errors="replace").partition("\n")[0] + "\n")


def survey(_request):
    """Whether all is installed."""
    import mininet.net  # noqa: F401
    from mininet.node import OVSController

    for program in PROGRAMS:
        if shutil.which(program) is None:
            raise Missing(program)
    if not OVSController.isAvailable():
        raise Missing("an OpenFlow controller (ovs-testcontroller)")
    # A host's namespaces, with a /sys of its own, which not every container may mount.
    tried = subprocess.run(["mnexec", "-n", "true"], stdout=subprocess.DEVNULL, stderr=subprocess.PIPE)
    if tried.returncode != 0:
        return {"refused": tried.stderr.decode(errors="replace").strip()}
    return {}


def owner():
    """Who made the bridge, so that others can tell whether that process still lives (proc(5): the 22nd field of stat is
    when it started)."""
    with open("/proc/self/stat") as stat:
        started = stat.read().rpartition(")")[2].split()[19]
    with open("/proc/sys/kernel/random/boot_id") as boot:
        boot_id = boot.read().strip()
    return f"{boot_id}/{os.readlink('/proc/self/ns/pid')}/{os.getpid()}/{started}"


def free_port():
    with socket.socket() as listener:
        listener.bind(("127.0.0.1", 0))
        return listener.getsockname()[1]


def classes(datapath, offloads):
    """Mininet's classes with what they keep to themselves: the commands of links, and what fails.

    The daemon's own datapath reads packets as they are, so that a checksum which the kernel left out would stay out, and
    a segment which it did not cut would not fit: there, links have no offloads from the beginning."""
    offloads_off = {"kernel": "tso off gso off", "user": "tx off tso off gso off"}[datapath]
    offloads = "none" if datapath == "user" else offloads
    from mininet.link import TCIntf, TCLink
    from mininet.node import Node, OVSController, OVSSwitch

    class Interface(TCIntf):
        def config(self, **params):
            if offloads == "mininet":
                return super().config(**params)
            outcome = super().config(txo=False, **params)
            command = f"ethtool -K {self.name} {offloads_off}"
            record(command, self.cmd(command))
            return outcome

        def tc(self, cmd, tc="tc"):
            output = super().tc(cmd, tc)
            record(cmd % (tc, self), output)
            return output

    class Link(TCLink):
        def __init__(self, *args, **kwargs):
            kwargs.update(cls1=Interface, cls2=Interface)
            super().__init__(*args, **kwargs)

        @classmethod
        def makeIntfPair(cls, name1, name2, *args, node1=None, node2=None, **kwargs):
            if node1 is None:
                *args, node1, node2 = args
            made = super().makeIntfPair(name1, name2, *args, node1=node1, node2=node2, **kwargs)
            # Before they go up: without an address the kernel neither looks for routers nor reports multicast groups.
            for node, name in ((node1, name1), (node2, name2)):
                node.cmd("ip link set dev", name, "addrgenmode none")
            return made

    class Switch(OVSSwitch):
        def __init__(self, *args, **kwargs):
            super().__init__(*args, datapath=datapath, **kwargs)

        # In the transaction that makes the bridge, so that none is ever without it.
        def bridgeOpts(self):
            return super().bridgeOpts() + f" external_ids:matrix-owner='\"{owner()}\"'"

        def vsctl(self, *args, **kwargs):
            said = super().vsctl(*args, **kwargs)
            if said and "ovs-vsctl:" in said:
                raise RuntimeError(said.strip())
            return said

    class LocalController(OVSController):
        # As Mininet's own, but it leaves no log and no socket behind and ends with the shell that started it.
        def start(self):
            self.cmd(
                "setpriv --pdeathsig KILL", self.command, self.cargs % self.port, "--unixctl=none >/dev/null 2>&1 &"
            )

        def stop(self, *args, **kwargs):
            self.cmd("kill %1; wait %1")
            Node.stop(self, *args, **kwargs)

        def runs(self):
            return self.cmd("jobs -r").strip() != ""

    return Link, Switch, LocalController


def up(request):
    """Builds the network, links unimpaired, and waits until the switch is connected to its controller."""
    import mininet.net

    # It would raise limits of the whole machine (`mininet.util.fixLimits`: sysctl) and never take them back.
    mininet.net.Mininet.inited = True
    link, switch_class, controller_class = classes(request["datapath"], request["offloads"])
    net = mininet.net.Mininet(
        build=False, link=link, switch=switch_class, controller=controller_class, autoStaticArp=True
    )
    network.append(net)
    name = request["name"]
    record_version("mn", "--version")
    controller = net.addController(name + "-c", port=free_port(), cargs="ptcp:%d:127.0.0.1")
    switches = [net.addSwitch(it["name"], dpid=it["name"].encode().hex()[-16:]) for it in request["switches"]]
    for host in request["hosts"]:
        node = net.addHost(host["name"], ip=host["ip"], mac=host["mac"])
        net.addLink(node, switches[host["switch"]], addr1=host["mac"])
    for switch, it in zip(switches, request["switches"]):
        if it["uplink"] is not None:
            net.addLink(switch, switches[it["uplink"]])
    record_version("ovs-vswitchd", "--version")
    record_version(controller.command, "--version")
    record_version("tc", "-V")
    net.start()
    for switch in switches:
        (uuid,) = switch.controllerUUIDs()
        switch.cmd("ovs-vsctl -t 30 wait-until Controller", uuid, "is_connected=true")
    if not controller.runs():
        raise RuntimeError(f"the OpenFlow controller {controller.command} ended on port {controller.port}")
    if not all(switch.connected() for switch in switches):
        raise RuntimeError("a switch has not found its OpenFlow controller within 30 s")
    return {
        "pids": [host.pid for host in net.hosts],
        "links": [[link.intf1.name, link.intf2.name] for link in net.links],
    }


def impair(request):
    """Mininet's own commands, at both ends of every link."""
    for link, wanted in zip(network[0].links, request["links"]):
        for interface in (link.intf1, link.intf2):
            outcome = interface.config(
                bw=wanted["bandwidth_mbit"],
                delay=wanted["delay"],
                jitter=wanted["jitter"],
                loss=wanted["loss_percent"],
                max_queue_size=wanted["limit_packets"],
            )
            said = "".join(outcome["tcoutputs"]).strip()
            if said and not said.startswith("Warning:"):
                raise RuntimeError(f"{interface}: {said}")
    return {}


def inspect(_request):
    """All that was run so far, and how the network stands now."""
    net = network[0]

    def look(node, *command):
        record(" ".join(command), node.cmd(*command))

    look(net.switches[0], "ovs-vsctl show")
    # The datapath: `system@…` is the kernel's, `netdev@…` that of the daemon itself.
    look(net.switches[0], "ovs-appctl --timeout=10 dpif/show")
    for switch in net.switches:
        look(switch, "ovs-vsctl list Controller", *switch.controllerUUIDs())
        look(switch, "ovs-ofctl dump-flows", switch.name)
        look(switch, "ovs-ofctl dump-ports", switch.name)
    for link in net.links:
        for interface in (link.intf1, link.intf2):
            look(interface.node, "tc -s qdisc show dev", interface.name)
            look(interface.node, "tc class show dev", interface.name)
            look(interface.node, "ethtool -k", interface.name, "| grep -E '^(rx|tx)-checksumming|^(tcp|generic)-'")
    return {"transcript": "".join(transcript)}


def down():
    while network:
        net = network.pop()
        try:
            net.stop()
        # Should Mininet give up half-way, the workload still looks for the bridge.
        except (Exception, SystemExit) as error:
            print(f"Mininet's network could not be stopped in order: {error}", file=sys.stderr)


# The one network, if there is one.
network = []


def main():
    # The workload blocks signals and hands that on; the hosts' shells and the controller have to end when told.
    signal.pthread_sigmask(signal.SIG_SETMASK, ())
    # Whoever sends these means the workload, which closes standard input when it has ended; handlers, unlike SIG_IGN,
    # are not handed on to the shells of the hosts.
    for number in (signal.SIGINT, signal.SIGTERM, signal.SIGHUP):
        signal.signal(number, lambda *_: None)
    handlers = {"survey": survey, "up": up, "impair": impair, "inspect": inspect}
    try:
        for line in sys.stdin:
            request = json.loads(line)
            say(handlers[request["do"]](request))
    except (ImportError, Missing) as error:
        say({"missing": f"Python's module {error.name}" if isinstance(error, ImportError) else str(error)})
    except BrokenPipeError:
        pass
    # Mininet ends the process where it finds something amiss.
    except (Exception, SystemExit) as error:
        try:
            say({"error": str(error) or type(error).__name__})
        except BrokenPipeError:
            pass
    finally:
        down()


main()
