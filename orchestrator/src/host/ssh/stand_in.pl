#!/usr/bin/perl
# Stands in for the workload's keeper on a system that runs no workload, such as macOS: says what the host is, leases it,
# and refuses everything else. It is called as the workload is (`workload detached VERB`, `workload check`) and answers
# with the same records. In Perl with core modules, since that is on every macOS.
use strict;
use warnings;
use Fcntl qw(:DEFAULT :flock);
use JSON::PP ();
use Time::HiRes qw(time sleep);

my $JSON = JSON::PP->new->canonical;
my $system = said('uname', '-s');
my $WHY = "it runs $system, and the workload is a program for Linux";
my $HINT = 'have the workload run in a virtual machine or a container there';
# How often the lock is tried, and how long an older holder may take to end.
my ($LOOK_S, $PATIENCE_S) = (0.2, 5);

$| = 1;
my ($first, @rest) = @ARGV;
$first = '' unless defined $first;
if ($first eq 'check') {
    answer({
        format => 1, workload_version => '', can_run => JSON::PP::false,
        checks => [{
            name => 'system', required => JSON::PP::true, available => JSON::PP::false, reason => $WHY, fix => $HINT,
        }],
    });
    exit 0;
}
my ($verb, %option) = $first eq 'detached' ? @rest : ('');
if    ($verb eq 'platform') { platform($option{'--root'}) }
elsif ($verb eq 'list')     { answer({ environments => [], bridges => [] }) }
elsif ($verb eq 'lease')    { lease($option{'--path'}, seconds($option{'--beat'})) }
else                        { refuse($WHY, $HINT) }

# The first line that a program says; nothing where there is none.
sub said {
    my @command = @_;
    open(my $pipe, '-|', @command) or return '';
    my $line = <$pipe>;
    close $pipe;
    $line = '' unless defined $line;
    chomp $line;
    return $line;
}

sub answer { print $JSON->encode($_[0]), "\n" }

sub refuse {
    my ($error, $hint) = @_;
    print STDERR $JSON->encode({ error => $error, hint => $hint }), "\n";
    exit 1;
}

sub platform {
    my ($root) = @_;
    my $darwin = $system eq 'Darwin';
    # The nearest folder that is there already.
    $root =~ s{/[^/]*$}{} while $root ne '' && !-d $root;
    open(my $df, '-|', 'df', '-kP', $root eq '' ? '/' : $root) or refuse("df: $!", undef);
    my @lines = <$df>;
    close $df;
    my $free_kib = (split ' ', $lines[-1] || '')[3];
    answer({
        format => 1,
        machine => said('uname', '-m'),
        os => $darwin ? 'macos-' . said('sw_vers', '-productVersion') : lc $system,
        kernel => said('uname', '-r'),
        kernel_build => said('uname', '-v'),
        hostname => said('uname', '-n'),
        cpu_model => $darwin ? said('sysctl', '-n', 'machdep.cpu.brand_string') : undef,
        cpus_allowed => $darwin ? 0 + said('sysctl', '-n', 'hw.ncpu') : 0,
        memory_total_bytes => $darwin ? 0 + said('sysctl', '-n', 'hw.memsize') : undef,
        clock_resolution_ns => 0,
        workload_version => '',
        realtime => {
            priority_asked => 0, priority_granted => 0, lock_asked => JSON::PP::false, locked => JSON::PP::false,
        },
        free_bytes => 1024 * ($free_kib || 0),
        uid => 0 + $<,
        now_ns => int(time * 1e9),
    });
}

sub seconds {
    my ($text) = @_;
    my %unit = (ms => 0.001, s => 1, min => 60, h => 3600);
    defined $text && $text =~ /^([\d.]+)(ms|s|min|h)$/ or refuse('no such duration', undef);
    return $1 * $unit{$2};
}

# One user at a time, as long as its connection lives: workload/src/detached/lease.rs has the rules. The lock is tried again
# and again, so that who waits is not always the first to come next; who comes back tries without a pause.
sub lease {
    my ($path, $beat) = @_;
    my $request = eval { $JSON->decode(line($beat)) };
    refuse('a token and a holder were expected', undef) unless ref $request eq 'HASH' && defined $request->{token};
    my $is_new = !-e $path;
    sysopen(my $file, $path, O_RDWR | O_CREAT | O_NOFOLLOW, 0666) or refuse("cannot open $path: $!", undef);
    -f $file or refuse("cannot open $path: it is not a regular file", undef);
    # Whatever our mask is.
    chmod 0666, $file if $is_new;
    my ($granted, $told, $asked_to_end) = (0, 0, undef);
    my $heard = time;
    while (1) {
        my $pause = $granted ? $beat : $LOOK_S;
        if (!$granted && flock($file, LOCK_EX | LOCK_NB)) {
            note($file, $request);
            $granted = 1;
            answer({ granted => JSON::PP::true });
            $pause = $beat;
        }
        elsif (!$granted) {
            my $held = holder($file);
            my $process = $held->{'lease-process'};
            if (defined $process && $process =~ /^\d+$/ && ($held->{'lease-token'} || '') eq $request->{token}) {
                $asked_to_end = time unless defined $asked_to_end;
                kill(time - $asked_to_end > $PATIENCE_S ? 'KILL' : 'TERM', $process);
                $pause = 0.005;
            }
            elsif (!$told) {
                delete @$held{'lease-token', 'lease-process'};
                answer({ held => %$held ? $held : undef });
                $told = 1;
            }
        }
        my $left = $heard + $beat - time;
        refuse("nothing came for $beat s", undef) if $left <= 0;
        my $came = piece($pause < $left ? $pause : $left);
        exit 0 if defined $came && $came eq '';
        $heard = time if defined $came;
    }
}

# What comes on standard input within some seconds: nothing yet (undef), or its end ('').
sub piece {
    my ($within) = @_;
    my $ready = '';
    vec($ready, fileno(STDIN), 1) = 1;
    return undef unless select($ready, undef, undef, $within) > 0;
    my $read = sysread(STDIN, my $bytes, 4096);
    refuse("cannot read standard input: $!", undef) unless defined $read;
    return $read ? $bytes : '';
}

sub line {
    my ($beat) = @_;
    my $text = '';
    while ($text !~ /\n/ && length $text < 16384) {
        my $came = piece($beat);
        refuse("nothing came for $beat s", undef) unless defined $came;
        last if $came eq '';
        $text .= $came;
    }
    return (split /\n/, $text)[0];
}

# Anybody may write there.
sub holder {
    my ($file) = @_;
    sysseek($file, 0, 0);
    sysread($file, my $text, 32768);
    my $held = eval { $JSON->decode($text) };
    return ref $held eq 'HASH' ? $held : {};
}

sub note {
    my ($file, $request) = @_;
    my $holder = ref $request->{holder} eq 'HASH' ? $request->{holder} : {};
    my $text = $JSON->encode({ %$holder, 'lease-token' => $request->{token}, 'lease-process' => $$ });
    truncate($file, 0);
    sysseek($file, 0, 0);
    syswrite($file, $text);
}
