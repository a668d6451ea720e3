//! The calling side: keeps its connections, since each new one costs a round trip. The main type is [`Client`].

use std::{
    sync::{Mutex, PoisonError},
    time::Instant,
};

use super::{
    document::{DocumentError, read_response, write_call},
    http::{HttpError, Inbox, Message, Role, request},
    server::Fault,
    value::Value,
};
use crate::ros::{
    RosError,
    address::{Address, resolve},
    socket::Socket,
    stop::{Stop, WaitError},
};

/// How many connections are kept for later calls.
const MOST_IDLE: usize = 4;

/// Why a call failed.
#[derive(Debug, thiserror::Error)]
pub(in crate::ros) enum CallError {
    #[error("cannot connect: {0}")]
    Connect(#[source] WaitError),
    #[error("the connection broke: {0}")]
    Exchange(#[source] WaitError),
    #[error("the answer is not understood: {0}")]
    Http(#[from] HttpError),
    #[error("the answer is not understood: {0}")]
    Document(#[from] DocumentError),
    #[error("{0}")]
    Fault(#[from] Fault),
    /// The answer does not have ROS's form of status, words and value.
    #[error("the answer is not one of ROS's")]
    NotRos,
    /// ROS's own way to refuse.
    #[error("{0}")]
    Refused(String),
}

/// Calls one server.
#[derive(Debug)]
pub(in crate::ros) struct Client {
    address: Address,
    stop: Stop,
    idle: Mutex<Vec<Socket>>,
}

impl Client {
    /// For the server at this URI; does not connect yet.
    pub fn new(uri: &str, stop: Stop) -> Result<Self, RosError> {
        Ok(Self {
            address: resolve(uri)?,
            stop,
            idle: Mutex::default(),
        })
    }

    pub fn address(&self) -> &Address {
        &self.address
    }

    /// Connects beforehand, so that a later call takes one trip and not two round trips.
    pub fn connect_ahead(&self, deadline: Instant) -> Result<(), CallError> {
        let socket = self.connect(deadline)?;
        self.keep(socket);
        Ok(())
    }

    /// A connection of its own to the server, for who wants to know when it ends.
    pub fn open_line(&self, deadline: Instant) -> Result<Socket, CallError> {
        self.connect(deadline)
    }

    /// Calls a method of ROS and takes its answer apart: status, words, value.
    pub fn call_ros(&self, method: &str, params: &[Value], deadline: Instant) -> Result<Value, CallError> {
        let Value::Array(answer) = self.call(method, params, deadline)? else {
            return Err(CallError::NotRos);
        };
        match <[Value; 3]>::try_from(answer) {
            Ok([Value::Int(1), Value::Text(_), value]) => Ok(value),
            Ok([Value::Int(_), Value::Text(words), _]) => Err(CallError::Refused(words)),
            _ => Err(CallError::NotRos),
        }
    }

    /// Calls a method.
    pub fn call(&self, method: &str, params: &[Value], deadline: Instant) -> Result<Value, CallError> {
        let body = write_call(method, params);
        let bytes = request(&self.address.authority, &self.address.path, &body);
        let kept = self.idle.lock().unwrap_or_else(PoisonError::into_inner).pop();
        let message = match kept.map(|socket| self.exchange(socket, &bytes, deadline)) {
            Some(Ok(message)) => message,
            // A kept connection may have been closed by the server meanwhile. All methods of ROS can be called twice.
            None | Some(Err(CallError::Exchange(WaitError::Closed | WaitError::Io(_)))) => {
                self.exchange(self.connect(deadline)?, &bytes, deadline)?
            }
            Some(Err(error)) => return Err(error),
        };
        Ok(read_response(&message.body)??)
    }

    fn connect(&self, deadline: Instant) -> Result<Socket, CallError> {
        let socket =
            Socket::connect(self.address.socket, &self.stop, deadline).map_err(CallError::Connect)?;
        socket
            .set_nodelay()
            .map_err(|error| CallError::Connect(error.into()))?;
        Ok(socket)
    }

    fn exchange(&self, socket: Socket, request: &[u8], deadline: Instant) -> Result<Message, CallError> {
        socket.write_all(request, deadline).map_err(CallError::Exchange)?;
        let mut inbox = Inbox::new(Role::Responses);
        let mut buffer = [0; 4096];
        let message = loop {
            if let Some(message) = inbox.next()? {
                break message;
            }
            match socket.read(&mut buffer, Some(deadline)) {
                Ok(count) => inbox.take_in(buffer.get(..count).unwrap_or_default()),
                Err(WaitError::Closed) => {
                    break inbox.close()?.ok_or(CallError::Exchange(WaitError::Closed))?;
                }
                Err(error) => return Err(CallError::Exchange(error)),
            }
        };
        if message.keep_alive {
            self.keep(socket);
        }
        Ok(message)
    }

    fn keep(&self, socket: Socket) {
        let mut idle = self.idle.lock().unwrap_or_else(PoisonError::into_inner);
        if idle.len() < MOST_IDLE {
            idle.push(socket);
        }
    }

    #[cfg(test)]
    pub fn idle_connections(&self) -> usize {
        self.idle.lock().unwrap_or_else(PoisonError::into_inner).len()
    }
}
