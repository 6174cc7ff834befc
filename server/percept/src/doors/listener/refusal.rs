//! What a client is told for which there is no place, in its own protocol.

use super::Protocol;
use percept_service::{observe, reason};
use std::time::Duration;
use tokio::io::{AsyncReadExt, AsyncWriteExt};
use tokio::net::TcpStream;

/// Time that a refusal may take.
const TIME: Duration = Duration::from_secs(1);

/// A problem as RFC 9457 has it.
const BODY: &str = "{\"type\":\"urn:percept:error:too_many_connections\",\"title\":\"Service Unavailable\",\
    \"status\":503,\"detail\":\"too many connections are open, in all or from this address; use one for several requests, or \
    try again\",\"reason\":\"TOO_MANY_CONNECTIONS\",\"field\":\"\",\"code\":\"UNAVAILABLE\"}";

/// RFC 9113: an empty SETTINGS frame, then GOAWAY for stream 0 with `ENHANCE_YOUR_CALM` (11).
const GO_AWAY: [u8; 26] = [0, 0, 0, 4, 0, 0, 0, 0, 0, 0, 0, 8, 7, 0, 0, 0, 0, 0, 0, 0, 0, 0, 0, 0, 0, 11];

/// Refuses a connection. Over TLS it is only closed: agreeing on keys is what there is no room for.
pub(super) async fn say(mut socket: TcpStream, protocol: Protocol, is_encrypted: bool) {
    observe::shed(reason::TOO_MANY_CONNECTIONS);
    if is_encrypted {
        return;
    }
    let words = match protocol {
        Protocol::Rest => http(),
        Protocol::Grpc => GO_AWAY.to_vec(),
    };
    let _ = tokio::time::timeout(TIME, async {
        socket.write_all(&words).await?;
        socket.shutdown().await?;
        // Closing on unread bytes would reset the connection, and with it what was said.
        let mut rest = [0; 4096];
        while socket.read(&mut rest).await? > 0 {}
        std::io::Result::Ok(())
    })
    .await;
}

fn http() -> Vec<u8> {
    let length = BODY.len();
    format!(
        "HTTP/1.1 503 Service Unavailable\r\ncontent-type: application/problem+json\r\ncontent-length: {length}\r\n\
         retry-after: 1\r\nconnection: close\r\n\r\n{BODY}"
    )
    .into_bytes()
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_refusal_is_a_problem_with_the_time_to_try_again() {
        let problem: serde_json::Value = serde_json::from_str(BODY).unwrap();
        assert_eq!(problem["reason"], "TOO_MANY_CONNECTIONS");
        assert!(String::from_utf8(http()).unwrap().contains("retry-after: 1\r\n"));
    }
}
