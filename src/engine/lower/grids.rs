//! Workgroups of dispatches over as many rows as a count on the device says: one dispatch a stage computes
//! those of all in a table, of which each takes its row.

use crate::engine::graph::TensorId;
use crate::engine::kernels::indirect_grid::{MOST, table};
use crate::engine::kernels::{Command, Dispatch, Grid, Recording};
use crate::engine::ops::IndirectGrid;
use crate::engine::shape::TensorSpec;

/// Bytes of a row of a table.
const ROW: u64 = 12;

/// What one dispatch computes.
struct Table {
    stage: usize,
    count: TensorId,
    picture: Option<u32>,
    /// The first command that needs it; the count is written before.
    first: usize,
    rules: Vec<IndirectGrid>,
    grids: TensorId,
}

/// Makes each [`Grid::Counted`] a [`Grid::Indirect`]. `owners` has an operation for each command; a table's
/// is that of the first command that needs it.
pub(super) fn tabulate(recording: &mut Recording, owners: &mut Vec<usize>) {
    let starts: Vec<usize> = recording.stages().iter().map(|stage| stage.first).collect();
    let mut tables: Vec<Table> = Vec::new();
    for at in 0..recording.commands().len() {
        let Command::Dispatch(dispatch) = &recording.commands()[at] else { continue };
        let (Grid::Counted(count, rule), picture) = (dispatch.grid, dispatch.picture) else {
            continue;
        };
        let stage = starts.partition_point(|first| *first <= at);
        let fits = |t: &Table| {
            (t.stage, t.count, t.picture) == (stage, count, picture)
                && (t.rules.len() < MOST || t.rules.contains(&rule))
        };
        let index = tables.iter().position(fits).unwrap_or_else(|| {
            let grids = recording.scratch("grids", TensorSpec::u32([MOST, 3]));
            tables.push(Table { stage, count, picture, first: at, rules: Vec::new(), grids });
            tables.len() - 1
        });
        let Table { rules, grids, .. } = &mut tables[index];
        let row = rules.iter().position(|r| *r == rule).unwrap_or_else(|| {
            rules.push(rule);
            rules.len() - 1
        });
        recording.set_grid(at, Grid::Indirect(*grids, row as u64 * ROW));
    }
    // From the last on: what is put in moves none that is still to come.
    for Table { picture, count, first, rules, grids, .. } in tables.into_iter().rev() {
        recording.insert(first, Dispatch { picture, ..table(&rules, count, grids) });
        owners.insert(first, owners[first]);
    }
}

#[cfg(test)]
mod tests {
    use std::collections::BTreeSet;

    use super::*;
    use crate::engine::graph::Graph;
    use crate::engine::kernels::{self, Caps};
    use crate::engine::lower::{KernelChoice, Lowered, Request, lower};
    use crate::engine::ops::{OPS, Softmax};
    use crate::engine::precision::Precision;
    use crate::engine::shader::reflect;
    use crate::engine::shape::Extent;

    fn lowered(graph: &Graph, batch: u32, caps: &Caps, kernels: &KernelChoice) -> Lowered {
        let precision = Precision::F32;
        lower(graph, &Request { keep: &[], batch, precision, caps, kernels }).expect("kernels")
    }

    /// Three softmaxes of two sizes in one stage and one in the next, for two pictures.
    #[test]
    fn counts_of_a_stage_share_a_table() {
        let mut graph = Graph::default();
        let count = graph.input("count", TensorSpec::u32([1]), Extent::Exact);
        for (stage, rows) in [("first", 100), ("first", 50), ("first", 100), ("second", 50)] {
            graph.begin_stage(stage);
            let input = graph.input("input", TensorSpec::f32([rows, 3]), Extent::Exact);
            let softmax = Softmax { temperature: 1.0, count: true };
            let output = graph.apply1("output", softmax, &[input, count]).expect("rows");
            graph.mark_output(output);
        }
        let lowered = lowered(&graph, 2, &Caps::default(), &KernelChoice::default());
        let stages = lowered.recording.stages().iter();
        assert_eq!(stages.map(|s| s.first).collect::<Vec<_>>(), [0, 8], "6 and 2 tables, 2 and 2");
        assert_eq!(lowered.owners, [0, 0, 0, 0, 1, 1, 2, 2, 3, 3, 3, 3]);

        let mut tables: Vec<(TensorId, &Dispatch)> = Vec::new();
        let mut capacities = Vec::new();
        for (at, command) in lowered.recording.commands().iter().enumerate() {
            let Command::Dispatch(dispatch) = command else { panic!("a copy") };
            match dispatch.grid {
                Grid::Indirect(grids, byte) => {
                    let table = tables.iter().find(|(id, _)| *id == grids);
                    let (_, table) = table.unwrap_or_else(|| panic!("{at}: no table before it"));
                    assert_eq!(table.picture, dispatch.picture);
                    let rule = &table.params[(byte / ROW * 16) as usize..];
                    capacities.push(u32::from_le_bytes([rule[0], rule[1], rule[2], rule[3]]));
                }
                _ => {
                    let (_, grids) = dispatch.bindings[1];
                    tables.push((grids, dispatch));
                }
            }
        }
        assert_eq!(capacities, [100, 100, 50, 50, 100, 100, 50, 50]);
        assert_eq!(tables.len(), 4);
        let used = |params: &[u8]| params[MOST * 16];
        assert_eq!(tables.iter().map(|(_, t)| used(&t.params)).collect::<Vec<_>>(), [2, 2, 1, 1]);
    }

    /// More sizes than a table has rows.
    #[test]
    fn a_full_table_is_followed_by_another() {
        let mut graph = Graph::default();
        let count = graph.input("count", TensorSpec::u32([1]), Extent::Exact);
        for rows in 1..=MOST + 1 {
            let input = graph.input("input", TensorSpec::f32([rows, 3]), Extent::Exact);
            let softmax = Softmax { temperature: 1.0, count: true };
            let output = graph.apply1("output", softmax, &[input, count]).expect("rows");
            graph.mark_output(output);
        }
        let lowered = lowered(&graph, 1, &Caps::default(), &KernelChoice::default());
        let grids = lowered.recording.commands().iter().filter_map(|command| match command {
            Command::Dispatch(Dispatch { grid: Grid::Indirect(grids, row), .. }) => {
                Some((*grids, *row))
            }
            _ => None,
        });
        let grids: BTreeSet<_> = grids.map(|(id, row)| (id.0, row)).collect();
        assert_eq!(grids.len(), MOST + 1, "a row for each");
        assert_eq!(lowered.recording.commands().len(), MOST + 1 + 2);
    }

    /// What `crate::engine::gpu` builds on where it tells wgpu not to look at indirect dispatches.
    #[test]
    fn nothing_dispatched_by_count_asks_how_many_workgroups_there_are() {
        let mut found = BTreeSet::new();
        for sizes in Caps::SUBGROUPS {
            let caps = Caps::default().with_subgroups(sizes);
            let counted = OPS.iter().flat_map(|entry| (entry.cases)());
            for case in counted.filter(|case| case.op.inputs().contains(&"count")) {
                let mut graph = Graph::default();
                let names = case.op.inputs().into_iter();
                let values = names.zip(&case.inputs);
                let inputs: Vec<_> = values.map(|(n, v)| graph.constant(n, v.clone())).collect();
                let outputs = graph.apply_shared("op", case.op.clone(), &inputs).expect("shapes");
                outputs.iter().for_each(|id| graph.mark_output(*id));
                for kernel in kernels::named(case.op.name()) {
                    let kernels = KernelChoice::force(kernel.id()).expect("a kernel");
                    for command in lowered(&graph, 1, &caps, &kernels).recording.commands() {
                        let Command::Dispatch(dispatch) = command else { continue };
                        if let Grid::Indirect(..) = dispatch.grid {
                            let Dispatch { shader, variant, entry, .. } = dispatch;
                            if !found.insert((shader.stem, variant.clone(), *entry)) {
                                continue;
                            }
                            let entries = reflect(shader, variant).expect("a shader").entries;
                            let own = entries.iter().find(|e| e.name == *entry).expect("an entry");
                            assert!(!own.reads_grid, "{}::{entry}", shader.stem);
                        }
                    }
                }
            }
        }
        let stems: BTreeSet<_> = found.iter().map(|(stem, _, _)| *stem).collect();
        let expected = ["linear/gemm", "linear/planar", "roi_align/planar", "softmax"];
        assert_eq!(stems, BTreeSet::from(expected));
    }
}
