//! The sources of packets, and which of them the settings ask for: [`open`].

use record::{
    settings::{CaptureSettings, CaptureTool},
    virtual_host::VirtualHost,
};

use super::{
    error::CaptureError,
    filter,
    packet_socket::PacketSocket,
    packet_source::PacketSource,
    stamping,
    tcpdump::{self, Tcpdump},
};

/// Opens a source on an interface of the calling thread's namespace, as the settings ask. Call it on the thread that
/// will read: a tool ends with the thread that started it.
///
/// # Errors
/// If there is no such interface, no right to it, or no such tool.
pub fn open(
    host: VirtualHost,
    interface: &str,
    settings: &CaptureSettings,
) -> Result<Box<dyn PacketSource>, CaptureError> {
    let source: Box<dyn PacketSource> = match settings.tool {
        CaptureTool::Builtin => {
            let filter = settings.filter.as_deref().map(filter::compile).transpose()?;
            Box::new(PacketSocket::open(host, interface, filter.as_deref())?)
        }
        CaptureTool::Tcpdump => Box::new(Tcpdump::start(host, interface, settings)?),
    };
    stamping::wait_until_live().map_err(|source| CaptureError::Socket {
        host,
        action: "waiting for the kernel to stamp packets",
        source,
    })?;
    Ok(source)
}

/// Whether such captures can be made here.
///
/// # Errors
/// What is missing.
pub fn survey(settings: &CaptureSettings) -> Result<(), CaptureError> {
    if settings.tool == CaptureTool::Tcpdump {
        tcpdump::survey()?;
    }
    settings
        .filter
        .as_deref()
        .map_or(Ok(()), |expression| filter::compile(expression).map(drop))
}
