//! Parameters of a connection, which both nodes have.

use std::net::IpAddr;

use panoscope_node::{Open, Params, Validation};

use crate::link::{Endpoint, Role};

/// Where the other program is.
#[derive(Params)]
pub struct Connection {
    /// Who connects. Nodes with the same role, address and port share one connection, which carries messages both ways.
    #[param(default = "server", reopen)]
    pub role: Role,
    /// Server: address of this machine to listen on. 127.0.0.1 serves programs on this machine only, because anybody who reaches the port
    /// sees what is sent and can send: there is no password. 0.0.0.0 listens on all networks. Client: name or address of the machine to connect
    /// to.
    #[param(default = "127.0.0.1", reopen)]
    pub address: String,
    /// TCP port; 18944 is the protocol's own. 0 lets a server take a free one, which the log and the metric `port` name.
    #[param(default = 18944, range = 0..=65535, reopen)]
    pub port: u16,
    /// Messages of one device that may wait for a slow program, or for the graph; with more the oldest is dropped and counted. Of pictures and
    /// surfaces two wait at most.
    #[param(default = 256, range = 1..=65536, reopen)]
    pub queue: u32,
}

impl Connection {
    /// Key of the connection.
    pub fn endpoint(&self) -> Endpoint {
        Endpoint { role: self.role, address: self.address.trim().to_owned(), port: self.port }
    }

    /// Reports parameters with which nothing can be connected.
    pub fn check(&self, check: &mut Validation<'_>) {
        let address = self.address.trim();
        match self.role {
            Role::Server if address.parse::<IpAddr>().is_err() => {
                let help = "write 127.0.0.1, 0.0.0.0 or the address of a network card";
                check.error("address", format!("`{address}` is not an IP address to listen on"), help);
            }
            Role::Client if address.is_empty() || address.contains(|c: char| c.is_whitespace() || c == '/') => {
                let help = "write a name or an IP address, such as 127.0.0.1; the port is a parameter of its own";
                check.error("address", format!("`{address}` names no machine"), help);
            }
            Role::Client if self.port == 0 => {
                check.error("port", "a client cannot connect to port 0", "write the port of the server, such as 18944");
            }
            _ => {}
        }
    }

    /// Warns where other machines are served.
    pub fn warn(&self, open: &Open<'_>) {
        let is_public = self.address.trim().parse::<IpAddr>().is_ok_and(|address| !address.is_loopback());
        if self.role == Role::Server && is_public {
            open.warn(&format!(
                "`address = \"{}\"`: other machines on this network see what is sent and can send; there is no password",
                self.address
            ));
        }
    }
}

/// Checks a device name.
pub fn check_name(check: &mut Validation<'_>, param: &str, name: &str) {
    if name.len() > panoscope_igtl::NAME_BYTES {
        let message =
            format!("`{name}` has {} bytes, a device name has at most {}", name.len(), panoscope_igtl::NAME_BYTES);
        check.error(param, message, "write a shorter name");
    }
}
