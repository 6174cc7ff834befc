use super::*;

const S: Duration = Duration::from_secs(1);

fn look(protocol: Protocol) -> Look {
    Look {
        protocol,
        under_way: 0,
        quiet: Duration::ZERO,
        since_quiet: 0,
        received: 100,
        write_waits: None,
        finishing: None,
        is_stopping: false,
    }
}

fn verdict(look: Look) -> Verdict {
    let limits = Limits { header_timeout_s: 10, idle_timeout_s: 300, unread_timeout_s: 30, ..Limits::default() };
    look.verdict(&limits)
}

#[test]
fn half_a_header_is_cut_and_a_resting_connection_finished() {
    let rest = || look(Protocol::Rest);
    assert_eq!(verdict(Look { quiet: 9 * S, since_quiet: 5, ..rest() }), Verdict::Stay);
    assert_eq!(verdict(Look { quiet: 10 * S, since_quiet: 5, ..rest() }), Verdict::Cut);
    assert_eq!(verdict(Look { quiet: 10 * S, received: 0, ..rest() }), Verdict::Cut, "not a byte");
    assert_eq!(verdict(Look { quiet: 299 * S, ..rest() }), Verdict::Stay);
    assert_eq!(verdict(Look { quiet: 300 * S, ..rest() }), Verdict::Finish);
    assert_eq!(verdict(Look { quiet: 900 * S, under_way: 1, ..rest() }), Verdict::Stay);
}

#[test]
fn a_client_of_grpc_says_its_preface_in_time() {
    let grpc = || look(Protocol::Grpc);
    assert_eq!(verdict(Look { quiet: 10 * S, received: 23, ..grpc() }), Verdict::Cut);
    assert_eq!(verdict(Look { quiet: 10 * S, since_quiet: 17, ..grpc() }), Verdict::Stay, "pings are no header");
    assert_eq!(verdict(Look { quiet: 300 * S, ..grpc() }), Verdict::Finish);
}

#[test]
fn what_is_not_read_ends_sooner_when_the_server_stops() {
    let unread =
        |s, is_stopping| verdict(Look { under_way: 1, write_waits: Some(s * S), is_stopping, ..look(Protocol::Rest) });
    assert_eq!((unread(29, false), unread(30, false)), (Verdict::Stay, Verdict::Cut));
    assert_eq!((unread(1, true), unread(2, true)), (Verdict::Stay, Verdict::Cut));
}

#[test]
fn a_finishing_connection_without_requests_is_cut_after_the_grace() {
    let finishing = |s, under_way| {
        let seen = Look { finishing: Some(s * S), quiet: 900 * S, under_way, ..look(Protocol::Grpc) };
        verdict(Look { is_stopping: true, ..seen })
    };
    assert_eq!((finishing(1, 0), finishing(2, 0)), (Verdict::Stay, Verdict::Cut));
    assert_eq!(finishing(900, 1), Verdict::Stay, "accepted work is finished");
}
