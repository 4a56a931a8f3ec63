//! `driver-tests`: test cases on real kernel drivers, one after the other.
//!
//! Runs in the virtual machine that `scripts/driver-vm.sh` boots. Exit status: 0 all passed, 1 some failed, 2 wrong
//! options or no such case.
#![expect(clippy::print_stdout, reason = "a test program talks on standard output")]

mod cases;

use std::panic::{AssertUnwindSafe, catch_unwind};
use std::process::ExitCode;
use std::time::Instant;

use clap::Parser;

/// Runs the test cases on real kernel drivers, in the virtual machine of scripts/driver-vm.sh.
#[derive(Parser)]
struct Options {
    /// Run only cases whose name contains this; may be given more than once
    #[arg(long, value_name = "NAME")]
    only: Vec<String>,
    /// Leave out cases whose name contains this; may be given more than once
    #[arg(long, value_name = "NAME")]
    except: Vec<String>,
    /// List the cases and run none
    #[arg(long)]
    list: bool,
}

/// One test: `Err` says why it failed.
pub(crate) struct Case {
    pub(crate) name: &'static str,
    pub(crate) run: fn() -> Result<(), String>,
}

fn main() -> ExitCode {
    let options = Options::parse();
    let has_any = |case: &Case, parts: &[String]| parts.iter().any(|part| case.name.contains(part));
    let wanted =
        |case: &Case| (options.only.is_empty() || has_any(case, &options.only)) && !has_any(case, &options.except);
    let cases: Vec<Case> = cases::all().into_iter().filter(wanted).collect();
    if cases.is_empty() {
        println!(
            "error: no case has `{}` in its name that is not left out; --list lists them",
            options.only.join("` or `")
        );
        return ExitCode::from(2);
    }
    if options.list {
        for case in &cases {
            println!("{}", case.name);
        }
        return ExitCode::SUCCESS;
    }
    let failed = cases.iter().filter(|case| !passes(case)).count();
    println!("{} cases, {} failed", cases.len(), failed);
    if failed == 0 {
        ExitCode::SUCCESS
    } else {
        ExitCode::from(1)
    }
}

/// Runs a case and says how it went. A panic is a failure like any other; its message is on standard error.
fn passes(case: &Case) -> bool {
    let start = Instant::now();
    let result = catch_unwind(AssertUnwindSafe(case.run)).unwrap_or_else(|_| Err("it panicked".to_owned()));
    match result {
        Ok(()) => println!("ok {} ({:.1} s)", case.name, start.elapsed().as_secs_f32()),
        Err(ref reason) => println!("FAILED {}: {reason}", case.name),
    }
    result.is_ok()
}
