//! Essential matrices `E` with `second^T E first = 0` for five matches (Nister 2004).
//!
//! The five equations leave `E = x E0 + y E1 + z E2 + E3`. The ten cubics `det E = 0` and `2 E E^T E = tr(E E^T) E`
//! are eliminated to three equations linear in `x`, `y`, `1` whose coefficients are polynomials in `z`; their determinant
//! has degree ten, and its real roots are isolated by a Sturm chain.

use crate::geometry::{Matrix, Vector, cross, dot};

/// Degree of the polynomial in `z`.
const DEGREE: usize = 10;
/// Polynomial in `z`, constant first.
type Polynomial = [f64; DEGREE + 1];
/// Coefficients of x, y, z, 1.
type Linear = [f64; 4];
/// Coefficients of the products of two of x, y, z, 1, in the order of [`SQUARE`].
type Quadratic = [f64; 10];
/// Coefficients of the products of three, in the order of [`CUBE`].
type Cubic = [f64; 20];

/// Place of the product of two variables: xx, xy, xz, x, yy, yz, y, zz, z, 1.
const SQUARE: [[usize; 4]; 4] = [[0, 1, 2, 3], [1, 4, 5, 6], [2, 5, 7, 8], [3, 6, 8, 9]];
/// Place of a product of two times a variable. The first ten are those that are eliminated: x^3, y^3, x^2 y, x y^2, x^2 z,
/// x^2, y^2 z, y^2, xyz, xy; then x z^2, xz, x, y z^2, yz, y, z^3, z^2, z, 1.
const CUBE: [[usize; 4]; 10] = [
    [0, 2, 4, 5],
    [2, 3, 8, 9],
    [4, 8, 10, 11],
    [5, 9, 11, 12],
    [3, 1, 6, 7],
    [8, 6, 13, 14],
    [9, 7, 14, 15],
    [10, 13, 16, 17],
    [11, 14, 17, 18],
    [12, 15, 18, 19],
];

/// Calls `found` with each real essential matrix that fits five matches. Matches in special position may give none.
pub fn essential_matrices(first: &[Vector<3>; 5], second: &[Vector<3>; 5], mut found: impl FnMut(&Matrix<3>)) {
    let Some(basis) = null_space(first, second) else { return };
    let Some(reduced) = eliminate(constraints(&basis)) else { return };
    let rows = polynomial_rows(&reduced);
    for_each_root(&determinant(&rows), |z| {
        let at = rows.map(|row| row.map(|p| evaluate(&p, z)));
        // x : y : 1 is perpendicular to all three rows; the longest of the products is the safest
        let products = [cross(&at[0], &at[1]), cross(&at[1], &at[2]), cross(&at[2], &at[0])];
        let best = products.iter().fold(&products[0], |a, b| if dot(b, b) > dot(a, a) { b } else { a });
        let [x, y] = [best[0] / best[2], best[1] / best[2]];
        let e: [f64; 9] = std::array::from_fn(|k| dot(&basis[k], &[x, y, z, 1.0]));
        let size = dot(&e, &e).sqrt();
        if size.is_finite() && size > 0.0 {
            found(&std::array::from_fn(|r| std::array::from_fn(|c| e[3 * r + c] / size)));
        }
    });
}

/// The four matrices that fit the five equations, entry by entry: `[k]` holds entry `k` of each (Householder).
fn null_space(first: &[Vector<3>; 5], second: &[Vector<3>; 5]) -> Option<[Linear; 9]> {
    let mut columns: [[f64; 9]; 5] =
        std::array::from_fn(|i| std::array::from_fn(|k| second[i][k / 3] * first[i][k % 3]));
    let mut reflectors = [[0.0; 9]; 5];
    for i in 0..5 {
        let mut v = columns[i];
        v[..i].fill(0.0);
        let length = dot(&v, &v).sqrt();
        // two matches that are one leave nothing of the second column
        if length.is_nan() || length < 1e-10 {
            return None;
        }
        v[i] += if v[i] < 0.0 { -length } else { length };
        let scale = (2.0 / dot(&v, &v)).sqrt();
        reflectors[i] = v.map(|x| scale * x);
        for column in &mut columns[i + 1..] {
            reflect(&reflectors[i], column);
        }
    }
    let mut basis = [[0.0; 4]; 9];
    for n in 0..4 {
        let mut vector = [0.0; 9];
        vector[5 + n] = 1.0;
        for reflector in reflectors.iter().rev() {
            reflect(reflector, &mut vector);
        }
        for k in 0..9 {
            basis[k][n] = vector[k];
        }
    }
    Some(basis)
}

#[inline(always)]
fn reflect(v: &[f64; 9], x: &mut [f64; 9]) {
    let along = dot(v, x);
    for k in 0..9 {
        x[k] -= along * v[k];
    }
}

#[inline(always)]
fn add_square(sum: &mut Quadratic, a: &Linear, b: &Linear, sign: f64) {
    for i in 0..4 {
        for j in 0..4 {
            sum[SQUARE[i][j]] += sign * a[i] * b[j];
        }
    }
}

#[inline(always)]
fn add_cube(sum: &mut Cubic, a: &Quadratic, b: &Linear) {
    for i in 0..10 {
        for j in 0..4 {
            sum[CUBE[i][j]] += a[i] * b[j];
        }
    }
}

/// The ten cubics: nine entries of `(E E^T - tr(E E^T) / 2) E`, and the determinant.
fn constraints(e: &[Linear; 9]) -> [Cubic; 10] {
    let mut gram = [[[0.0; 10]; 3]; 3];
    for r in 0..3 {
        for c in r..3 {
            for k in 0..3 {
                add_square(&mut gram[r][c], &e[3 * r + k], &e[3 * c + k], 1.0);
            }
            gram[c][r] = gram[r][c];
        }
    }
    let half: Quadratic = std::array::from_fn(|k| 0.5 * (gram[0][0][k] + gram[1][1][k] + gram[2][2][k]));
    for r in 0..3 {
        for k in 0..10 {
            gram[r][r][k] -= half[k];
        }
    }
    let mut cubics = [[0.0; 20]; 10];
    for r in 0..3 {
        for c in 0..3 {
            for k in 0..3 {
                add_cube(&mut cubics[3 * r + c], &gram[r][k], &e[3 * k + c]);
            }
        }
        let mut minor = [0.0; 10];
        let (a, b) = ((r + 1) % 3, (r + 2) % 3);
        add_square(&mut minor, &e[3 + a], &e[6 + b], 1.0);
        add_square(&mut minor, &e[3 + b], &e[6 + a], -1.0);
        add_cube(&mut cubics[9], &minor, &e[r]);
    }
    cubics
}

/// Gauss elimination of the first ten monomials; returns what the last six of them equal (with the sign turned).
fn eliminate(mut m: [Cubic; 10]) -> Option<[[f64; 10]; 6]> {
    for c in 0..10 {
        let pivot = (c..10).fold(c, |best, r| if m[r][c].abs() > m[best][c].abs() { r } else { best });
        m.swap(c, pivot);
        if m[c][c].is_nan() || m[c][c].abs() < 1e-13 {
            return None;
        }
        let inverse = 1.0 / m[c][c];
        let row = m[c].map(|x| inverse * x);
        m[c] = row;
        // the first four monomials are needed by nobody: no back-substitution into their rows
        for r in (4..c).chain(c + 1..10) {
            let factor = m[r][c];
            for k in c..20 {
                m[r][k] -= factor * row[k];
            }
        }
    }
    Some(std::array::from_fn(|r| std::array::from_fn(|k| m[4 + r][10 + k])))
}

/// Rows `<x^2 z> - z <x^2>`, `<y^2 z> - z <y^2>`, `<xyz> - z <xy>`: polynomials in `z` that multiply x, y and 1.
fn polynomial_rows(reduced: &[[f64; 10]; 6]) -> [[[f64; 5]; 3]; 3] {
    std::array::from_fn(|r| {
        let (e, f) = (&reduced[2 * r], &reduced[2 * r + 1]);
        let cubic = |k: usize| [e[k + 2], e[k + 1] - f[k + 2], e[k] - f[k + 1], -f[k], 0.0];
        [cubic(0), cubic(3), [e[9], e[8] - f[9], e[7] - f[8], e[6] - f[7], -f[6]]]
    })
}

fn determinant(rows: &[[[f64; 5]; 3]; 3]) -> Polynomial {
    let mut sum = [0.0; DEGREE + 1];
    for r in 0..3 {
        let (a, b) = (&rows[(r + 1) % 3], &rows[(r + 2) % 3]);
        let mut minor = [0.0; 7];
        for i in 0..4 {
            for j in 0..4 {
                minor[i + j] += a[0][i] * b[1][j] - a[1][i] * b[0][j];
            }
        }
        for (i, m) in minor.iter().enumerate() {
            for (j, last) in rows[r][2].iter().enumerate() {
                sum[i + j] += m * last;
            }
        }
    }
    sum
}

#[inline(always)]
fn evaluate<const N: usize>(p: &[f64; N], z: f64) -> f64 {
    p.iter().rev().fold(0.0, |sum, c| sum * z + c)
}

/// Remainders of the Euclidean algorithm of a polynomial and its derivative, signs turned: the number of sign changes along
/// the chain falls by one at each real root.
struct Sturm {
    chain: [Polynomial; DEGREE + 1],
    degree: [usize; DEGREE + 1],
    len: usize,
}

impl Sturm {
    fn new(p: &Polynomial, degree: usize) -> Self {
        let mut sturm = Self { chain: [[0.0; DEGREE + 1]; DEGREE + 1], degree: [0; DEGREE + 1], len: 2 };
        sturm.chain[0] = *p;
        sturm.degree[0] = degree;
        for k in 1..=degree {
            sturm.chain[1][k - 1] = k as f64 * p[k];
        }
        sturm.degree[1] = degree - 1;
        while sturm.degree[sturm.len - 1] > 0 {
            let (mut rest, by) = (sturm.chain[sturm.len - 2], &sturm.chain[sturm.len - 1]);
            let (high, low) = (sturm.degree[sturm.len - 2], sturm.degree[sturm.len - 1]);
            let size = rest.iter().fold(0.0, |m: f64, c| m.max(c.abs()));
            for k in (low..=high).rev() {
                let quotient = rest[k] / by[low];
                for j in 0..=low {
                    rest[k - low + j] -= quotient * by[j];
                }
                rest[k] = 0.0;
            }
            let largest = rest[..low].iter().fold(0.0, |m: f64, c| m.max(c.abs()));
            let Some(degree) = (0..low).rev().find(|&k| rest[k].abs() > 1e-14 * largest) else { break };
            if largest.is_nan() || largest <= 1e-15 * size {
                break;
            }
            sturm.chain[sturm.len] = rest.map(|c| -c / largest);
            sturm.chain[sturm.len][degree + 1..].fill(0.0);
            sturm.degree[sturm.len] = degree;
            sturm.len += 1;
        }
        sturm
    }

    fn sign_changes(&self, z: f64) -> usize {
        let (mut changes, mut negative) = (0, None);
        for (p, &degree) in self.chain[..self.len].iter().zip(&self.degree) {
            let value = p[..=degree].iter().rev().fold(0.0, |sum, c| sum * z + c);
            if value != 0.0 {
                changes += usize::from(negative.is_some_and(|n| n != (value < 0.0)));
                negative = Some(value < 0.0);
            }
        }
        changes
    }
}

/// Calls `found` with each real root; roots that coincide are given once.
fn for_each_root(p: &Polynomial, mut found: impl FnMut(f64)) {
    let largest = p.iter().fold(0.0, |m: f64, c| m.max(c.abs()));
    let Some(degree) = (1..=DEGREE).rev().find(|&k| p[k].abs() > 1e-13 * largest) else { return };
    if !largest.is_finite() {
        return;
    }
    let p: Polynomial = std::array::from_fn(|k| if k > degree { 0.0 } else { p[k] / p[degree] });
    // Fujiwara's bound on the size of the roots
    let bound = (0..degree).map(|k| p[k].abs().powf(1.0 / (degree - k) as f64)).fold(0.0, f64::max) * 2.0 + 1e-9;
    let sturm = Sturm::new(&p, degree);
    let mut open = [(0.0, 0.0, 0usize, 0usize); 64];
    open[0] = (-bound, bound, sturm.sign_changes(-bound), sturm.sign_changes(bound));
    let mut n_open = 1;
    while n_open > 0 {
        n_open -= 1;
        let (low, high, at_low, at_high) = open[n_open];
        let middle = 0.5 * (low + high);
        match at_low.saturating_sub(at_high) {
            0 => {}
            1 => found(polish(&p, low, high)),
            _ if high - low < 1e-9 * (1.0 + bound) || n_open + 2 > open.len() => found(middle),
            _ => {
                let at_middle = sturm.sign_changes(middle);
                open[n_open] = (middle, high, at_middle, at_high);
                open[n_open + 1] = (low, middle, at_low, at_middle);
                n_open += 2;
            }
        }
    }
}

/// The root between two bounds: Newton's step where it stays between them, else half the interval.
fn polish(p: &Polynomial, mut low: f64, mut high: f64) -> f64 {
    let rising = evaluate(p, high) > 0.0;
    let mut z = 0.5 * (low + high);
    for _ in 0..60 {
        let (mut value, mut slope) = (0.0, 0.0);
        for c in p.iter().rev() {
            slope = slope * z + value;
            value = value * z + c;
        }
        if (value > 0.0) == rising {
            high = z;
        } else {
            low = z;
        }
        let step = value / slope;
        let next = if (low..high).contains(&(z - step)) { z - step } else { 0.5 * (low + high) };
        if (next - z).abs() <= 1e-12 * (1.0 + z.abs()) {
            return next;
        }
        z = next;
    }
    z
}

#[cfg(test)]
#[allow(clippy::unwrap_used)]
mod tests {
    use super::*;

    #[test]
    fn the_roots_of_a_polynomial_are_all_found() {
        let wanted: [f64; 6] = [-7.5, -1.0, -0.25, 0.5, 0.51, 40.0];
        let mut p = [0.0; DEGREE + 1];
        p[0] = 1.0;
        // times (z - root) for each, and twice (z^2 + z + 2), which has none
        let factors = wanted.iter().map(|r| [-r, 1.0, 0.0]).chain([[2.0, 1.0, 1.0]; 2]);
        for factor in factors {
            let mut product = [0.0; DEGREE + 1];
            for i in 0..=DEGREE {
                for (j, f) in factor.iter().enumerate() {
                    if i + j <= DEGREE {
                        product[i + j] += p[i] * f;
                    }
                }
            }
            p = product;
        }
        let mut found = Vec::new();
        for_each_root(&p, |z| found.push(z));
        assert_eq!(found.len(), wanted.len(), "{found:?}");
        for (a, b) in found.iter().zip(wanted) {
            assert!((a - b).abs() < 1e-8 * (1.0 + b.abs()), "{found:?}");
        }
    }

    #[test]
    fn every_matrix_found_is_essential_and_fits() {
        let unit = |v: Vector<3>| crate::geometry::normalized(&v);
        let points: [Vector<3>; 5] =
            [[1.0, 2.0, 5.0], [-3.0, 1.0, 2.0], [2.0, -2.0, -4.0], [-1.0, -5.0, 1.0], [4.0, 0.5, -1.0]];
        let rotation = crate::geometry::Rotation::exp(&[0.4, -2.0, 0.7]);
        let center = [0.5, -0.3, 0.8];
        let first = points.map(unit);
        let second = points.map(|x| rotation.apply(&unit(crate::geometry::sub(&x, &center))));
        let s = rotation.apply(&unit(center));
        let truth: Matrix<3> = std::array::from_fn(|r| {
            std::array::from_fn(|c| {
                let column: Vector<3> = std::array::from_fn(|k| rotation.matrix()[k][c]);
                cross(&s, &column)[r] / 2.0f64.sqrt()
            })
        });
        let (mut count, mut nearest) = (0, f64::MAX);
        essential_matrices(&first, &second, |e| {
            count += 1;
            for (a, b) in first.iter().zip(&second) {
                assert!(dot(b, &crate::geometry::apply(e, a)).abs() < 1e-12);
            }
            let gram: Matrix<3> = std::array::from_fn(|r| std::array::from_fn(|c| dot(&e[r], &e[c])));
            for r in 0..3 {
                for c in 0..3 {
                    let cubic: f64 = (0..3).map(|k| 2.0 * gram[r][k] * e[k][c]).sum::<f64>() - e[r][c];
                    assert!(cubic.abs() < 1e-6, "{cubic}");
                }
            }
            let apart = |sign: f64| {
                let pairs = e.iter().flatten().zip(truth.iter().flatten());
                pairs.map(|(x, y)| (x - sign * y).abs()).fold(0.0, f64::max)
            };
            nearest = nearest.min(apart(1.0)).min(apart(-1.0));
        });
        assert!((1..=10).contains(&count) && nearest < 1e-8, "{count} found, the nearest {nearest}");
    }
}
