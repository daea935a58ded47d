//! The registers of version 0.2.0: a PLC that was programmed for them still finds each where it was. Today's are those
//! of `docs/modbus.md`, whose tables are printed from the register map.

const THEN: &str = include_str!("../../../../host-tests/corpus/0.2.0/registers.txt");
const NOW: &str = include_str!("../../../../docs/modbus.md");

/// Returns address, place in an S7, name, type and unit of each register of a table, without what it means.
fn registers<'a>(page: &'a str, table: &str) -> Vec<Vec<&'a str>> {
    let (begin, end) = (format!("<!-- {table} -->"), format!("<!-- end of {table} -->"));
    let (_, rest) = page.split_once(&begin).expect("the mark of its begin");
    let (rows, _) = rest.split_once(&end).expect("the mark of its end");
    let rows = rows.lines().filter(|row| row.starts_with("| ")).skip(1);
    rows.map(|row| row.split('|').skip(1).take(5).map(str::trim).collect()).collect()
}

#[test]
fn every_register_of_0_2_0_is_where_it_was_and_none_lies_between() {
    for (table, count) in [("input registers", 22), ("holding registers", 12)] {
        let then = registers(THEN, table);
        assert_eq!(then.len(), count, "all were compared");
        // A block is read as a whole: its length belongs to it.
        assert_eq!(registers(NOW, table), then, "{table}");
    }
}
