//! The fault campaign and its committed table.

use host_sim::commands::faults::campaign;
use std::path::Path;

#[test]
fn no_fault_leads_to_uncontrolled_motion_and_the_table_is_as_committed() {
    let report = campaign(None, 2, &[]).unwrap();
    for row in &report.rows {
        assert!(row.wrong.is_empty(), "{}: {:?}", row.fault, row.wrong);
    }
    let page = Path::new(env!("CARGO_MANIFEST_DIR")).join("../docs/faults.md");
    let committed = std::fs::read_to_string(page).unwrap();
    let found = report.markdown();
    for (committed, found) in committed.lines().zip(found.lines()) {
        assert_eq!(
            committed, found,
            "scripts/regenerate.py faults rewrites the page"
        );
    }
    assert_eq!(committed, found);
}
