use std::process::{Command, Stdio};

use crate::samples::uwscan;

#[test]
fn wrong_usage_ends_with_2_and_says_what_is_meant() {
    let cases: &[(&[&str], &[&str])] = &[
        (&["explode"], &["explode"]),
        (&["calibrate"], &["<CAPTURE>", "--output"]),
        (&["calibrate", "a"], &["--output"]),
        (&["calibrate", "-o", "b.toml"], &["<CAPTURE>"]),
        (&["calibrate", "a", "-o", "b.toml", "--method", "magic"], &["joint", "paper"]),
        (&["calibrate", "a", "-o", "b.toml", "--threads", "0"], &["--threads"]),
        (&["calibrate", "a", "-o", "b.toml", "--threads", "100000"], &["--threads", "from 1 to 1024"]),
        (&["calibrate", "a", "-o", "b.toml", "-q", "-v"], &["--quiet", "--verbose"]),
        (&["reconstruct", "a", "-o", "b.ply"], &["--calibration"]),
        (&["reconstruct", "a", "-c", "c", "-o", "b.stl"], &["b.stl", ".ply, .pcd, .xyz"]),
        (&["reconstruct", "a", "-c", "c", "-o", "b"], &[".ply, .pcd, .xyz"]),
        (&["reconstruct", "a", "-c", "c", "-o", "b.ply", "--frame", "world"], &["camera", "galvo"]),
        (&["reconstruct", "a", "-c", "c", "-o", "b.ply", "--water-index", "nan"], &["from 1 to 2"]),
        (&["reconstruct", "a", "-c", "c", "-o", "b.ply", "--temperature", "10"], &["--salinity", "--depth"]),
        (
            &[
                "reconstruct",
                "a",
                "-c",
                "c",
                "-o",
                "b.ply",
                "--water-index",
                "1.33",
                "--temperature",
                "1",
                "--salinity",
                "1",
                "--depth",
                "1",
            ],
            &["--water-index", "cannot be used with"],
        ),
        (
            &["reconstruct", "a", "-c", "c", "-o", "b.ply", "--medium", "air", "--water-index", "1.33"],
            &["--medium air"],
        ),
        (&["fit"], &["sphere", "plane"]),
        (&["fit", "torus", "a.ply"], &["torus"]),
        (&["fit", "sphere", "a.las"], &["a.las", ".ply, .pcd, .xyz"]),
        (&["fit", "sphere", "a.ply", "--radius", "-3"], &["--radius", "positive number of millimetres"]),
        (&["fit", "sphere", "a.ply", "--radius", "inf"], &["positive number of millimetres"]),
        (&["fit", "sphere", "a.ply", "--radius", "1e300"], &["positive number of millimetres"]),
        (&["fit", "plane", "a.ply", "--radius", "3"], &["--radius"]),
        (&["shapes", "a.ply", "--max", "0"], &["--max", "give a whole number from 1"]),
        (&["scan", "--config", "v.toml", "--repeat", "0"], &["--repeat", "give a whole number from 1"]),
        (&["completions", "csh"], &["bash", "zsh", "fish"]),
    ];
    for (args, parts) in cases {
        // `uwscan fit` alone prints its help, which is no error line.
        if *args == ["fit"] {
            let run = uwscan(*args);
            assert_eq!(run.code, Some(2));
            parts.iter().for_each(|part| assert!(run.stderr.contains(part), "{}", run.stderr));
        } else {
            uwscan(*args).is_misused(parts);
        }
    }
}

#[test]
fn colour_is_as_asked_for_and_none_on_a_pipe() {
    let escape = '\u{1b}';
    for (args, colored) in [
        (&["info", "nowhere.toml"][..], false),
        (&["info", "nowhere.toml", "--color", "always"], true),
        (&["--color=never", "info", "nowhere.toml"], false),
        (&["--color=always", "explode"], true),
        (&["explode", "--color", "never"], false),
    ] {
        let run = uwscan(args);
        assert_ne!(run.code, Some(0));
        assert_eq!(run.stderr.contains(escape), colored, "{args:?}: {:?}", run.stderr);
    }
}

#[test]
fn help_and_version_are_results() {
    let commands = ["calibrate", "reconstruct", "fit", "info", "devices", "completions", "man"];
    let help = uwscan(["--help"]);
    for command in commands {
        assert!(help.text().contains(command), "{command}");
        let run = uwscan([command, "--help"]);
        assert!(run.text().contains("--threads") && run.text().contains("--color"), "{command}");
    }
    assert!(help.text().contains("3 done with loss"));
    assert_eq!(uwscan(["--version"]).text(), format!("uwscan {}\n", env!("CARGO_PKG_VERSION")));
}

#[test]
fn what_is_attached_is_listed_and_nothing_attached_is_no_failure() {
    let run = uwscan(["devices"]);
    let said = run.text();
    assert!(said.contains("serial ports\n") && said.contains("cameras\n"), "{said}");
    for (driver, has) in [("genicam", cfg!(feature = "genicam")), ("v4l2", cfg!(feature = "v4l2"))] {
        assert_eq!(said.contains(&format!("not compiled in: {driver}")), !has, "{said}");
        assert_eq!(said.contains(&format!("build with --features {driver}")), !has, "{said}");
    }
    let json = uwscan(["devices", "--json"]).json(0);
    assert!(json["serial_ports"].is_array() && json["cameras"].is_array(), "{json}");
    assert_eq!(json["warnings"], serde_json::json!([]), "{json}");
}

#[test]
fn every_shell_has_its_completions() {
    for (shell, sign) in [
        ("bash", "complete -F"),
        ("zsh", "#compdef uwscan"),
        ("fish", "complete -c uwscan"),
        ("elvish", "edit:completion:arg-completer[uwscan]"),
        ("powershell", "Register-ArgumentCompleter"),
    ] {
        let run = uwscan(["completions", shell]);
        assert!(run.text().contains(sign), "{shell}");
        for word in ["reconstruct", "water-index", "sphere"] {
            assert!(run.text().contains(word), "{shell} lacks {word}");
        }
    }
}

#[test]
fn the_manual_tells_every_command_and_the_exit_codes() {
    let run = uwscan(["man"]);
    let page = run.text().replace('\\', "");
    assert!(page.contains(".TH uwscan 1"));
    for part in
        ["UWSCAN CALIBRATE", "UWSCAN RECONSTRUCT", "UWSCAN FIT SPHERE", "UWSCAN FIT PLANE", "UWSCAN INFO"]
    {
        assert!(page.contains(&format!(".SH \"{part}\"")), "{part}");
    }
    for part in ["--water-index", "--radius", "uwscan fit sphere", "Exit codes"] {
        assert!(page.contains(part), "{part}");
    }
}

#[test]
fn a_reader_that_goes_away_is_no_failure() {
    let mut child = Command::new(assert_cmd::cargo::cargo_bin!("uwscan"))
        .args(["completions", "bash"])
        .stdout(Stdio::piped())
        .stderr(Stdio::piped())
        .spawn()
        .unwrap();
    drop(child.stdout.take());
    let output = child.wait_with_output().unwrap();
    assert_eq!((output.status.code(), output.stderr.as_slice()), (Some(0), &b""[..]));
}

#[cfg(target_os = "linux")]
#[test]
fn a_result_that_cannot_be_written_is_a_failure() {
    let full = std::fs::File::options().write(true).open("/dev/full").unwrap();
    let output =
        Command::new(assert_cmd::cargo::cargo_bin!("uwscan")).arg("man").stdout(full).output().unwrap();
    assert_eq!(output.status.code(), Some(1));
    let stderr = String::from_utf8(output.stderr).unwrap();
    assert!(stderr.starts_with("error: cannot write to standard output: "), "{stderr}");
}
