//! Sparse block systems against dense arithmetic: factorisation, slots, conjugate gradients, small decompositions.
#![allow(missing_docs, clippy::unwrap_used, clippy::expect_used, clippy::print_stderr, clippy::needless_range_loop)]

mod common;

use common::Noise;
use panopath::geometry::{Matrix, Rotation, Vector, apply, dot};
use panopath::least_squares::*;
use proptest::prelude::*;

/// A random positive definite block matrix: its pattern, its values and the same matrix dense.
struct System {
    pattern: BlockPattern,
    values: Vec<f64>,
    dense: Vec<Vec<f64>>,
}

/// Couples `n` nodes in a ring and at random, so that elimination fills in.
fn random_system<const D: usize>(n: usize, seed: u64) -> System {
    let mut noise = Noise::new(seed);
    let mut pairs: Vec<(usize, usize)> = (0..n).map(|i| (i, i)).collect();
    pairs.extend((0..n.saturating_sub(1)).map(|i| (i, i + 1)));
    for _ in 0..n {
        let (a, b) = ((noise.bits() % n as u64) as usize, (noise.bits() % n as u64) as usize);
        pairs.push((a.min(b), a.max(b)));
    }
    pairs.sort_unstable();
    pairs.dedup();
    let mut col_start = vec![0u32; n + 1];
    pairs.iter().for_each(|&(column, _)| col_start[column + 1] += 1);
    (0..n).for_each(|k| col_start[k + 1] += col_start[k]);
    let pattern = BlockPattern { col_start, row: pairs.iter().map(|&(_, row)| row as u32).collect() };
    let mut dense = vec![vec![0.0; n * D]; n * D];
    for &(a, b) in &pairs {
        for r in 0..D {
            for c in 0..D {
                let value = noise.normal();
                if a != b {
                    dense[a * D + r][b * D + c] = value;
                    dense[b * D + c][a * D + r] = value;
                }
            }
        }
    }
    // dominant diagonal, hence positive definite
    for k in 0..n * D {
        dense[k][k] = 1.0 + noise.uniform() + dense[k].iter().map(|v| v.abs()).sum::<f64>();
    }
    let values = values_of::<D>(&pattern, &dense);
    System { pattern, values, dense }
}

/// Lower-triangle values in the order the factorisation takes them.
fn values_of<const D: usize>(pattern: &BlockPattern, dense: &[Vec<f64>]) -> Vec<f64> {
    let n = pattern.n_nodes();
    let mut values = vec![f64::NAN; pattern.row.len() * D * D - n * (D * (D - 1) / 2)];
    for node in 0..n {
        for k in pattern.column(node) {
            let row = pattern.row[k] as usize;
            for c in 0..D {
                let slot = scalar_slots::<D>(pattern, node, k, c);
                let first = if row == node { c } else { 0 };
                for r in first..D {
                    assert!(values[slot + r - first].is_nan(), "a slot is used twice");
                    values[slot + r - first] = dense[row * D + r][node * D + c];
                }
            }
        }
    }
    assert!(values.iter().all(|v| !v.is_nan()), "a slot is not used");
    values
}

fn multiply(dense: &[Vec<f64>], x: &[f64]) -> Vec<f64> {
    dense.iter().map(|row| row.iter().zip(x).map(|(a, b)| a * b).sum()).collect()
}

fn difference(a: &[f64], b: &[f64]) -> f64 {
    a.iter().zip(b).map(|(x, y)| (x - y).abs()).fold(0.0, |m, x| if x > m || x.is_nan() { x } else { m })
}

fn cholesky_of<const D: usize>(system: &System) -> SparseCholesky {
    SparseCholesky::analyse::<D>(&system.pattern, &minimum_degree::<D>(&system.pattern).unwrap()).unwrap()
}

fn check_solve<const D: usize>(n: usize, seed: u64) {
    let system = random_system::<D>(n, seed);
    let mut cholesky = cholesky_of::<D>(&system);
    assert_eq!((cholesky.dim(), cholesky.n_values()), (n * D, system.values.len()));
    cholesky.factorise(&system.values).unwrap();
    let mut noise = Noise::new(seed ^ 1);
    let truth: Vec<f64> = (0..3 * n * D).map(|_| noise.normal()).collect();
    let mut x: Vec<f64> = truth.chunks(n * D).flat_map(|t| multiply(&system.dense, t)).collect();
    cholesky.solve(&mut x, 3).unwrap();
    assert!(difference(&x, &truth) < 1e-11, "d = {D}, {n} nodes");
    // the pattern is analysed once: other values, same object
    let doubled: Vec<f64> = system.values.iter().map(|v| 2.0 * v).collect();
    cholesky.factorise(&doubled).unwrap();
    let mut half = multiply(&system.dense, &truth[..n * D]);
    cholesky.solve(&mut half, 1).unwrap();
    assert!(half.iter().zip(&truth).all(|(h, t)| (2.0 * h - t).abs() < 1e-11));
}

proptest! {
    #![proptest_config(ProptestConfig { cases: 40, failure_persistence: None, ..ProptestConfig::default() })]

    #[test]
    fn the_sparse_factorisation_solves_the_dense_system(n in 1usize..40, seed in any::<u64>()) {
        check_solve::<1>(n, seed);
        check_solve::<2>(n, seed);
        check_solve::<3>(n, seed);
    }

    #[test]
    fn conjugate_gradients_reach_the_direct_solution(n in 1usize..40, seed in any::<u64>()) {
        let system = random_system::<3>(n, seed);
        let mut noise = Noise::new(seed ^ 2);
        let truth: Vec<f64> = (0..3 * n).map(|_| noise.normal()).collect();
        let b = multiply(&system.dense, &truth);
        let diagonal: Vec<f64> = (0..3 * n).map(|k| system.dense[k][k]).collect();
        for start in [0.0, 1.0] {
            let mut x = vec![start; 3 * n];
            let end = conjugate_gradients(
                |p: &[f64], q: &mut [f64]| q.copy_from_slice(&multiply(&system.dense, p)),
                |r: &[f64], z: &mut [f64]| z.iter_mut().zip(r).zip(&diagonal).for_each(|((z, r), d)| *z = r / d),
                &b,
                &mut x,
                1e-13,
                1000,
            );
            prop_assert!(difference(&x, &truth) < 1e-9, "{:?}", end);
            prop_assert!(end.relative_residual <= 1e-13 && end.count <= 1000);
        }
    }

    #[test]
    fn eigenvectors_of_symmetric_matrices(entries in prop::array::uniform9(-5.0..5.0f64)) {
        let m: Matrix<3> = std::array::from_fn(|r| std::array::from_fn(|c| entries[3 * r + c] + entries[3 * c + r]));
        let (values, vectors) = symmetric_eigen::<3>(&m).unwrap();
        prop_assert!(values[0] <= values[1] && values[1] <= values[2]);
        for k in 0..3 {
            let turned = apply(&m, &vectors[k]);
            for c in 0..3 {
                prop_assert!((turned[c] - values[k] * vectors[k][c]).abs() < 1e-12);
            }
            for l in 0..3 {
                prop_assert!((dot(&vectors[k], &vectors[l]) - f64::from(u8::from(k == l))).abs() < 1e-13);
            }
        }
    }

    #[test]
    fn the_nearest_rotation_is_the_best_of_many(entries in prop::array::uniform9(-2.0..2.0f64), seed in any::<u64>()) {
        let m: Matrix<3> = std::array::from_fn(|r| std::array::from_fn(|c| entries[3 * r + c]));
        let trace = |rotation: &Rotation<3>| -> f64 { (0..3).map(|r| dot(&rotation.matrix()[r], &m[r])).sum() };
        let best = nearest_rotation(&m).unwrap();
        let mut noise = Noise::new(seed);
        for _ in 0..50 {
            let phi: Vector<3> = std::array::from_fn(|_| 2.0 * noise.normal());
            prop_assert!(trace(&Rotation::exp(&phi)) <= trace(&best) + 1e-12);
        }
    }
}

#[test]
fn a_matrix_that_is_not_positive_definite_is_said_to_be_singular() {
    let system = random_system::<3>(10, 5);
    let mut cholesky = cholesky_of::<3>(&system);
    let zero = vec![0.0; system.values.len()];
    assert!(matches!(cholesky.factorise(&zero), Err(LeastSquaresError::Singular { .. })));
    let negative: Vec<f64> = system.values.iter().map(|v| -v).collect();
    assert!(matches!(cholesky.factorise(&negative), Err(LeastSquaresError::Singular { .. })));
    let nan = vec![f64::NAN; system.values.len()];
    assert!(cholesky.factorise(&nan).is_err());
    // and the object still serves
    cholesky.factorise(&system.values).unwrap();
}

#[test]
fn a_large_factorisation_has_the_same_bytes_on_any_number_of_threads() {
    // dense enough to be worth splitting
    let n = 260;
    let mut noise = Noise::new(1);
    let mut pairs: Vec<(usize, usize)> = (0..n).flat_map(|a| (a..n).map(move |b| (a, b))).collect();
    pairs.retain(|&(a, b)| a == b || noise.uniform() < 0.6);
    let mut col_start = vec![0u32; n + 1];
    pairs.iter().for_each(|&(column, _)| col_start[column + 1] += 1);
    (0..n).for_each(|k| col_start[k + 1] += col_start[k]);
    let pattern = BlockPattern { col_start, row: pairs.iter().map(|&(_, row)| row as u32).collect() };
    let mut dense = vec![vec![0.0; 3 * n]; 3 * n];
    for &(a, b) in &pairs {
        for k in 0..9 {
            let value = noise.normal();
            (dense[3 * a + k / 3][3 * b + k % 3], dense[3 * b + k % 3][3 * a + k / 3]) = (value, value);
        }
    }
    (0..3 * n).for_each(|k| dense[k][k] = 2000.0);
    let values = values_of::<3>(&pattern, &dense);
    let right: Vec<f64> = (0..3 * n).map(|_| noise.normal()).collect();
    let run = |threads: usize| -> Vec<u64> {
        let pool = rayon::ThreadPoolBuilder::new().num_threads(threads).build().unwrap();
        pool.install(|| {
            let mut cholesky = SparseCholesky::analyse::<3>(&pattern, &minimum_degree::<3>(&pattern).unwrap()).unwrap();
            cholesky.factorise(&values).unwrap();
            let mut x = right.clone();
            cholesky.solve(&mut x, 1).unwrap();
            assert!(difference(&multiply(&dense, &x), &right) < 1e-10);
            x.iter().map(|v| v.to_bits()).collect()
        })
    };
    let one = run(1);
    assert!(minimum_degree::<3>(&pattern).unwrap().factor_flops > 2e7, "large enough to be split");
    for threads in [1, 2, 3] {
        assert!(run(threads) == one, "{threads} threads");
    }
}

#[test]
fn predicted_cost_grows_with_fill() {
    let ring = random_system::<3>(50, 1);
    let sparse = minimum_degree::<3>(&ring.pattern).unwrap().factor_flops;
    let n = 50u32;
    let full = BlockPattern {
        col_start: (0..=n).map(|c| (0..c).map(|k| n - k).sum()).collect(),
        row: (0..n).flat_map(|c| c..n).collect(),
    };
    let dense = minimum_degree::<3>(&full).unwrap().factor_flops;
    let exact = 150f64.powi(3) / 3.0;
    assert!(sparse < dense && dense > 0.5 * exact && dense < 8.0 * exact, "{sparse}, {dense}, {exact}");
}

#[test]
fn conjugate_gradients_stop_where_told() {
    let system = random_system::<3>(30, 7);
    let b = vec![1.0; 90];
    let run = |tolerance, limit| {
        let mut x = vec![0.0; 90];
        let multiply = |p: &[f64], q: &mut [f64]| q.copy_from_slice(&multiply(&system.dense, p));
        conjugate_gradients(multiply, |r: &[f64], z: &mut [f64]| z.copy_from_slice(r), &b, &mut x, tolerance, limit)
    };
    assert_eq!(run(1e-12, 2).count, 2);
    let (coarse, fine) = (run(1e-2, 1000), run(1e-10, 1000));
    assert!(coarse.count < fine.count && coarse.relative_residual <= 1e-2 && fine.relative_residual <= 1e-10);
    // nothing to do
    let mut x = vec![0.0; 90];
    let multiply = |p: &[f64], q: &mut [f64]| q.copy_from_slice(p);
    let end =
        conjugate_gradients(multiply, |r: &[f64], z: &mut [f64]| z.copy_from_slice(r), &[0.0; 90], &mut x, 1e-10, 10);
    assert_eq!((end.count, end.relative_residual), (0, 0.0));
}

#[test]
fn what_is_not_finite_has_no_eigenvectors() {
    assert!(symmetric_eigen::<3>(&[[f64::NAN; 3]; 3]).is_err());
    assert!(nearest_rotation::<3>(&[[f64::NAN; 3]; 3]).is_none());
}

/// The inverse of a dense matrix by elimination with pivoting.
fn dense_inverse(mut a: Vec<Vec<f64>>) -> Vec<Vec<f64>> {
    let n = a.len();
    let mut b: Vec<Vec<f64>> = (0..n).map(|r| (0..n).map(|c| f64::from(u8::from(r == c))).collect()).collect();
    for k in 0..n {
        let pivot = (k..n).max_by(|&x, &y| a[x][k].abs().total_cmp(&a[y][k].abs())).unwrap();
        a.swap(k, pivot);
        b.swap(k, pivot);
        let p = a[k][k];
        a[k].iter_mut().for_each(|x| *x /= p);
        b[k].iter_mut().for_each(|x| *x /= p);
        for r in (0..n).filter(|&r| r != k) {
            let f = a[r][k];
            for c in 0..n {
                let (from_a, from_b) = (a[k][c], b[k][c]);
                a[r][c] -= f * from_a;
                b[r][c] -= f * from_b;
            }
        }
    }
    b
}

/// Every block of the pattern, both ways round, against the dense inverse; and the solution.
fn check_selected<const D: usize>(system: &System, what: &str) {
    let n = system.pattern.n_nodes();
    let selected = SelectedInverse::<D>::new(&system.pattern, &system.values).unwrap();
    let wanted = dense_inverse(system.dense.clone());
    for a in 0..n {
        for b in 0..n {
            let (row, column) = (a.max(b), a.min(b));
            let in_pattern = system.pattern.column(column).any(|k| system.pattern.row[k] as usize == row);
            let Some(block) = selected.block(a, b) else {
                assert!(!in_pattern, "{what}: block ({a}, {b}) is of the pattern");
                continue;
            };
            for r in 0..D {
                for c in 0..D {
                    let off = (block[r][c] - wanted[a * D + r][b * D + c]).abs();
                    let size = (wanted[a * D + r][a * D + r] * wanted[b * D + c][b * D + c]).sqrt();
                    assert!(off < 1e-11 * size, "{what}: block ({a}, {b}) entry ({r}, {c}) is off by {off}");
                }
            }
        }
    }
    let mut noise = Noise::new(8);
    let truth: Vec<f64> = (0..2 * n * D).map(|_| noise.normal()).collect();
    let mut x: Vec<f64> = truth.chunks(n * D).flat_map(|t| multiply(&system.dense, t)).collect();
    selected.solve(&mut x, 2).unwrap();
    assert!(difference(&x, &truth) < 1e-10, "{what}: solution");
}

/// A positive definite system on any pattern.
fn system_of<const D: usize>(n: usize, coupled: impl Fn(usize, usize) -> bool, seed: u64) -> System {
    let mut noise = Noise::new(seed);
    let (mut col_start, mut row) = (vec![0u32], Vec::new());
    let mut dense = vec![vec![0.0; n * D]; n * D];
    for a in 0..n {
        for b in (a..n).filter(|&b| a == b || coupled(a, b)) {
            row.push(b as u32);
            for (r, c) in (0..D * D).map(|k| (k / D, k % D)) {
                let value = noise.normal();
                dense[a * D + r][b * D + c] = value;
                dense[b * D + c][a * D + r] = value;
            }
        }
        col_start.push(row.len() as u32);
    }
    for k in 0..n * D {
        dense[k][k] = 0.5 + dense[k].iter().map(|v| v.abs()).sum::<f64>();
    }
    let pattern = BlockPattern { col_start, row };
    System { values: values_of::<D>(&pattern, &dense), pattern, dense }
}

fn check_selected_patterns<const D: usize>() {
    for seed in 0..12 {
        check_selected::<D>(&random_system::<D>(1 + 3 * seed as usize, seed), &format!("d = {D}, random {seed}"));
    }
    check_selected::<D>(&system_of::<D>(1, |_, _| false, 1), "one node");
    check_selected::<D>(&system_of::<D>(20, |_, _| false, 2), "diagonal");
    check_selected::<D>(&system_of::<D>(25, |_, _| true, 3), "dense");
    check_selected::<D>(&system_of::<D>(40, |a, b| b == a + 1, 4), "chain");
    check_selected::<D>(&system_of::<D>(40, |a, b| a == 0 || b == 39, 5), "arrows");
    check_selected::<D>(&system_of::<D>(36, |a, b| b == a + 6 || b == a + 1 && b % 6 > 0, 6), "grid");
    check_selected::<D>(&system_of::<D>(30, |a, b| b - a < 4 && a / 10 == b / 10, 7), "three parts");
}

#[test]
fn the_selected_inverse_is_that_of_the_dense_matrix() {
    check_selected_patterns::<1>();
    check_selected_patterns::<3>();
    check_selected_patterns::<6>();
}

#[test]
fn the_selected_inverse_of_a_singular_matrix_is_an_error() {
    let system = system_of::<3>(10, |a, b| b == a + 1, 1);
    for values in [vec![0.0; system.values.len()], vec![f64::NAN; system.values.len()]] {
        assert!(SelectedInverse::<3>::new(&system.pattern, &values).is_err());
    }
    let negative: Vec<f64> = system.values.iter().map(|v| -v).collect();
    assert!(matches!(SelectedInverse::<3>::new(&system.pattern, &negative), Err(LeastSquaresError::Singular { .. })));
}

#[test]
fn the_selected_inverse_has_the_same_bytes_on_any_number_of_threads() {
    let system = system_of::<6>(120, |a, b| b - a < 40, 1);
    let run = |threads: usize| -> Vec<u64> {
        let pool = rayon::ThreadPoolBuilder::new().num_threads(threads).build().unwrap();
        pool.install(|| {
            let selected = SelectedInverse::<6>::new(&system.pattern, &system.values).unwrap();
            (0..120).flat_map(|k| selected.block(k, k).unwrap().as_flattened().to_vec()).map(f64::to_bits).collect()
        })
    };
    assert!(run(1) == run(4));
}
