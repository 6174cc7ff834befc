use super::environment::{fields, names, tree};
use super::*;
use std::collections::BTreeSet;
use std::ffi::OsString;

fn env(pairs: &[(&str, &str)]) -> Vec<(OsString, OsString)> {
    pairs.iter().map(|(name, value)| (name.into(), value.into())).collect()
}

fn load(text: &str, pairs: &[(&str, &str)]) -> Result<Config, String> {
    let dir = tempfile::tempdir().unwrap();
    let path = dir.path().join("percept.toml");
    std::fs::write(&path, text).unwrap();
    let shown = format!("{}/", dir.path().display());
    Config::layered(Some(&path), env(pairs).into_iter()).map_err(|e| e.to_string().replace(&shown, ""))
}

fn complaint(text: &str, pairs: &[(&str, &str)]) -> String {
    load(text, pairs).unwrap_err()
}

/// `section.key` of every line `key = value` and `# key =`.
fn keys_of_template() -> BTreeSet<String> {
    let mut section = String::new();
    let mut keys = BTreeSet::new();
    for line in TEMPLATE.lines() {
        if let Some(name) = line.strip_prefix('[') {
            section = name.trim_end_matches(']').to_owned();
        } else if let Some((key, value)) = line.trim_start_matches("# ").split_once(" =")
            && key.chars().all(|c| c.is_ascii_lowercase() || c.is_ascii_digit() || c == '_')
            && (!line.starts_with('#') || value.is_empty())
        {
            keys.insert(format!("{section}.{key}"));
        }
    }
    keys
}

#[test]
fn the_template_has_every_field_with_its_default() {
    let advice = "run deploy/refresh-template";
    let defaults = tree(&Config::default());
    let code: BTreeSet<String> = fields(&defaults).into_iter().map(|(field, _)| field).collect();
    let template = keys_of_template();
    let missing: Vec<_> = code.difference(&template).collect();
    let surplus: Vec<_> = template.difference(&code).collect();
    assert!(missing.is_empty() && surplus.is_empty(), "{advice}: missing {missing:#?}, surplus {surplus:#?}");
    let parsed: Config = toml::from_str(TEMPLATE).unwrap();
    let differing: Vec<_> =
        fields(&tree(&parsed)).into_iter().zip(fields(&defaults)).filter(|(template, code)| template != code).collect();
    assert_eq!(parsed, Config::default(), "{advice}: differing (template, code) {differing:#?}");
}

#[test]
fn the_defaults_are_valid() {
    assert_eq!(Config::default().validate(), Ok(()));
}

#[test]
fn each_field_has_a_variable_of_its_own() {
    assert_eq!(names().len(), fields(&tree(&Config::default())).len());
    let taken: Vec<_> = names().into_keys().filter(|n| n.starts_with("PERCEPT_PORT")).collect();
    assert_eq!(taken, Vec::<String>::new());
}

#[test]
fn file_goes_over_defaults_and_environment_over_file() {
    let text = "[listen]\ngrpc = \"127.0.0.1:1\"\nrest = \"\"\n[params.map.cloud]\nvoxel_size_m = 0.2\n";
    let variables = [
        ("PERCEPT_LISTEN_GRPC", "[::1]:2"),
        ("PERCEPT_LIMITS_MAX_SESSIONS", "3"),
        ("PERCEPT_PARAMS_MAP_CLOUD_CARVE_WEIGHT", "1.5"),
        ("PERCEPT_PARAMS_SLAM_ODOMETRY_LIDAR3D_VOXEL_SIZE_M", "0.5"),
        ("PERCEPT_PARAMS_DETECTION_ENABLED", "false"),
        ("PERCEPT_LOG_FORMAT", "json"),
        ("PERCEPT_STORAGE_DATA_DIR", "/var/lib/percept"),
    ];
    let config = load(text, &variables).unwrap();
    let mut expected = Config::default();
    expected.listen.grpc = "[::1]:2".to_owned();
    expected.listen.rest = String::new();
    expected.limits.max_sessions = 3;
    expected.params.map.cloud.voxel_size_m = 0.2;
    expected.params.map.cloud.carve_weight = 1.5;
    expected.params.slam.odometry.lidar3d.voxel_size_m = Some(0.5);
    expected.params.detection.enabled = false;
    expected.log.format = LogFormat::Json;
    expected.storage.data_dir = PathBuf::from("/var/lib/percept");
    assert_eq!(config, expected);
}

#[test]
fn variables_of_other_purposes_are_let_be() {
    let others = [("PERCEPT_DATA", "x"), ("PERCEPT_BIN", "x"), ("PERCEPT_CONFIG", "x"), ("HOME", "x")];
    let linked = [("PERCEPT_SERVICE_HOST", "10.0.0.1"), ("PERCEPT_PORT_50051_TCP", "tcp://10.0.0.1:50051")];
    assert_eq!(load("", &[&others[..], &linked[..]].concat()), Ok(Config::default()));
}

#[test]
fn the_server_starts_beside_variables_that_options_of_other_commands_read() {
    let options = crate::cli::variables();
    // Of `health`, as the image's health check is told about TLS.
    assert!(["PERCEPT_SERVER", "PERCEPT_CA_FILE", "PERCEPT_TOKEN"].iter().all(|name| options.contains(*name)));
    let settings = names();
    for option in options.iter().filter(|name| !settings.contains_key(*name)) {
        assert_eq!(load("", &[(option, "x")]), Ok(Config::default()), "{option}");
    }
}

#[test]
fn complaints_name_place_field_value_and_remedy() {
    let said = |text: &str, pairs: &[(&str, &str)], expected: &str| {
        let complaint = complaint(text, pairs);
        assert!(complaint.contains(expected), "{complaint:?} lacks {expected:?}");
    };
    said("[limits]\n\nmax_session = 3\n", &[], "percept.toml:3: unknown field `max_session`, expected one of");
    said("[compute]\nthreads = \"two\"\n", &[], "percept.toml:2: invalid type: string \"two\"");
    said("[compute]\nthreads = -2\n", &[], "percept.toml:2: ");
    said("[listen]\n\ngrpc = 1 2\n", &[], "percept.toml:3: ");
    said("[log]\nlevel = \"loud\"\n", &[], "percept.toml:2: log.level is \"loud\"; ");
    said("[log]\nlevel = \"percept=loud\"\n", &[], "percept.toml:2: log.level is \"percept=loud\"; ");
    said("[log]\nformat = \"xml\"\n", &[], "percept.toml:2: unknown variant `xml`, expected `text` or `json`");
    said("[limits]\nmax_sessions = 0\n", &[], "percept.toml:2: limits.max_sessions is 0; set it between 1 and");
    said(
        "",
        &[("PERCEPT_LIMITS_MAX_SESSIONS", "0")],
        "environment PERCEPT_LIMITS_MAX_SESSIONS: limits.max_sessions is 0",
    );
    said("", &[("PERCEPT_LIMITS_MAX_SESSIONS", "ten")], "PERCEPT_LIMITS_MAX_SESSIONS is \"ten\"; write a whole number");
    said("", &[("PERCEPT_LOG_FORMAT", "xml")], "PERCEPT_LOG_FORMAT is \"xml\"; does not fit: unknown variant");
    said(
        "",
        &[("PERCEPT_COMPUTE_NICE", "300")],
        "environment PERCEPT_COMPUTE_NICE: compute.nice is 300; set it between 0 and 19",
    );
    said(
        "",
        &[("PERCEPT_LISTEN_GRCP", "x")],
        "unknown variable PERCEPT_LISTEN_GRCP, perhaps meant: PERCEPT_LISTEN_GRPC",
    );
    said(
        "",
        &[("PERCEPT_LIMITS_MAX_MAP_MB", "512")],
        "unknown variable PERCEPT_LIMITS_MAX_MAP_MB, perhaps meant: PERCEPT_LIMITS_MAX_SESSION_MEMORY_MB",
    );
    said(
        "[listen]\nrest = \"localhost\"\n",
        &[],
        "percept.toml:2: listen.rest is \"localhost\"; write IP address and port",
    );
    said("[listen]\nzenoh = \"127.0.0.1:7447\"\n", &[], "listen.zenoh is \"127.0.0.1:7447\"; write tcp/");
    said("[listen]\ngrpc = \"127.0.0.1:8080\"\n", &[], "listen.rest is \"127.0.0.1:8080\"; take another port");
    said("[listen]\ngrpc = \"\"\nrest = \"\"\nzenoh = \"\"\n", &[], "open at least one door");
    said("[recording]\nsessions = \"a b\"\n", &[], "recording.sessions is \"a b\"; write 1 to 64 characters");
    said("[recording]\nmax_file_mb = 0\n", &[], "recording.max_file_mb is 0; set it between 1 and 1048576");
    said(
        "[recording]\nmax_waiting_total_mb = 8\n",
        &[],
        "recording.max_waiting_total_mb is 8; set it between 16 and 1048576",
    );
    said("[storage]\ndata_dir = \"\"\n", &[], "percept.toml:2: storage.data_dir is empty; name a directory");
    said("[params.map.cloud]\n# thin\nvoxel_size_m = 0\n", &[], "percept.toml:3: params.map");
    said("[params.detection]\nrange_m = 99\n", &[], "percept.toml:2: params.detection.range_m is 99; set it between");
    said(
        "[params.slam.odometry.tracking]\nmax_gap_s = nan\n",
        &[],
        "percept.toml:2: params.slam.odometry.tracking.max_gap_s",
    );
}

#[test]
fn nobody_is_let_in_from_beyond_this_machine_unless_it_is_said_in_so_many_words() {
    let addresses = [("grpc", "0.0.0.0:1"), ("rest", "[::]:1"), ("rest", "192.168.0.7:1"), ("zenoh", "tcp/0.0.0.0:1")];
    for (door, address) in addresses {
        let text = format!("[listen]\n{door} = \"{address}\"\n");
        let refused = complaint(&text, &[]);
        assert!(refused.contains(door) && refused.contains("auth.allow_anonymous_beyond_loopback"), "{refused}");
        assert!(load(&text, &[("PERCEPT_AUTH_ALLOW_ANONYMOUS_BEYOND_LOOPBACK", "true")]).is_ok());
        let required = [("PERCEPT_AUTH_MODE", "required"), ("PERCEPT_AUTH_KEYS_FILE", "keys.json")];
        assert!(load(&text, &required).is_ok());
    }
    for near in
        ["grpc = \"[::1]:1\"", "rest = \"127.9.9.9:1\"", "zenoh = \"tcp/localhost:1\"", "zenoh = \"tcp/[::1]:1\""]
    {
        assert!(load(&format!("[listen]\n{near}\n"), &[]).is_ok(), "{near}");
    }
}

#[test]
fn metrics_are_shown_beyond_this_machine_only_if_it_is_said_in_so_many_words() {
    let apart = "[telemetry]\nlisten = \"0.0.0.0:9464\"\n";
    let required = [("PERCEPT_AUTH_MODE", "required"), ("PERCEPT_AUTH_KEYS_FILE", "keys.json")];
    for settings in [&[][..], &required] {
        let refused = complaint(apart, settings);
        assert!(refused.starts_with("percept.toml:2: telemetry.listen is \"0.0.0.0:9464\"; "), "{refused}");
        assert!(refused.contains("set auth.open_metrics = true"), "{refused}");
        assert!(load(apart, &[settings, &[("PERCEPT_AUTH_OPEN_METRICS", "true")]].concat()).is_ok());
        assert!(load("[telemetry]\nlisten = \"127.0.0.1:9464\"\n", settings).is_ok());
    }
    assert!(load(apart, &[("PERCEPT_AUTH_ALLOW_ANONYMOUS_BEYOND_LOOPBACK", "true")]).is_ok());
}

#[test]
fn rules_for_certificates_that_no_client_is_asked_for_are_refused() {
    let rule = "[auth]\nmode = \"required\"\n[[auth.certificates]]\nsubject = \"cn:robot-7\"\naccess = \"write\"\n";
    let tls = "[tls]\ncert_file = \"a\"\nkey_file = \"b\"\n";
    for text in [rule.to_owned(), format!("{rule}{tls}")] {
        let refused = complaint(&text, &[]);
        assert!(refused.contains("auth.certificates is for cn:robot-7; "), "{refused}");
        assert!(refused.contains("set tls.client_ca_file"), "{refused}");
    }
    assert!(load(&format!("{rule}{tls}client_ca_file = \"c\"\n"), &[]).is_ok());
}

#[test]
fn who_may_call_is_read_from_file_and_environment() {
    let text = "[auth]\nmode = \"required\"\n[[auth.certificates]]\nsubject = \"cn:robot-7\"\naccess = \"write\"\n\
                sessions = \"robot-7*\"\n[tls]\ncert_file = \"a\"\nkey_file = \"b\"\nclient_ca_file = \"c\"\n";
    let config = load(text, &[]).unwrap();
    assert_eq!(config.auth.certificates[0].tenant, "default");
    let entry = r#"[{"subject": "dns:x", "tenant": "a", "access": "read"}]"#;
    let config = load("", &[("PERCEPT_AUTH_CERTIFICATES", entry)]).unwrap();
    assert_eq!(config.auth.certificates[0].sessions.as_str(), "*");
    assert!(
        complaint("[auth]\nmode = \"required\"\n", &[])
            .contains("percept.toml:2: auth.mode is \"required\"; but nothing")
    );
    assert!(complaint("[auth]\nmode = \"off\"\n", &[]).contains("percept.toml:2"));
    assert!(toml::to_string_pretty(&config).is_ok());
}

#[test]
fn both_sides_of_a_limit_are_told_apart() {
    let with = |threads| Config { compute: Compute { threads, nice: 19 }, ..Config::default() }.validate();
    assert_eq!(with(1024), Ok(()));
    assert!(matches!(with(1025), Err(ConfigError::OutOfBounds { field, .. }) if field == "compute.threads"));
}

#[test]
fn an_absent_file_is_an_error_that_says_how_to_get_one() {
    let complaint = Config::load(Some(Path::new("no/such.toml"))).unwrap_err().to_string();
    assert!(complaint.contains("no/such.toml") && complaint.contains("percept config"), "{complaint}");
}
