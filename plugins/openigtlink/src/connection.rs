//! Parameters of a connection, which both nodes share.

use std::net::IpAddr;

use panoscope_node::{Open, Params, Validation};

use crate::link::{Endpoint, Role};

/// Address of the other program, and which side connects.
#[derive(Params)]
pub struct Connection {
    /// Which side connects. Nodes with the same role, address and port share one connection, which carries messages both ways.
    #[param(default = "server", reopen)]
    pub role: Role,
    /// Server: address of this machine to listen on. 127.0.0.1 serves only programs on this machine; 0.0.0.0 listens on all networks. There is no
    /// password: anybody who reaches the port can read and send messages. Client: name or address of the machine to connect to.
    #[param(default = "127.0.0.1", reopen)]
    pub address: String,
    /// TCP port; the protocol's own is 18944. 0 lets a server take a free port, which the log and the metric `port` name.
    #[param(default = 18944, range = 0..=65535, reopen)]
    pub port: u16,
    /// Maximum number of messages per device that wait for a slow program or for the graph; beyond it the oldest is dropped and counted. At most two
    /// images or surfaces wait.
    #[param(default = 256, range = 1..=65536, reopen)]
    pub queue: u32,
}

impl Connection {
    /// Key of the connection.
    pub fn endpoint(&self) -> Endpoint {
        Endpoint { role: self.role, address: self.address.trim().to_owned(), port: self.port }
    }

    /// Reports parameters that cannot work.
    pub fn check(&self, check: &mut Validation<'_>) {
        let address = self.address.trim();
        match self.role {
            Role::Server if address.parse::<IpAddr>().is_err() => {
                let help = "write 127.0.0.1, 0.0.0.0 or the address of a network card";
                check.error("address", format!("`{address}` is not an IP address to listen on"), help);
            }
            Role::Client if address.is_empty() || address.contains(|c: char| c.is_whitespace() || c == '/') => {
                let help = "write a name or an IP address, such as 127.0.0.1; the port is a separate parameter";
                check.error("address", format!("`{address}` is not the name of a machine"), help);
            }
            Role::Client if self.port == 0 => {
                check.error("port", "a client cannot connect to port 0", "write the port of the server, such as 18944");
            }
            _ => {}
        }
    }

    /// Warns if other machines can connect.
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
