//! Functions of time that paths are made of: `P(t) = sum_l B_l(t) p_l` (Knill and Ramirez-Herran 2007, section 6).

/// The form of a path. Numbers that are NaN are to be filled in for each track, or found.
#[derive(Debug, Clone, PartialEq)]
pub enum Form {
    /// A point at rest.
    Static,
    /// Powers `((t - origin) / unit)^l`, `l <= order`.
    Taylor {
        /// Highest power.
        order: usize,
        /// Time zero; NaN: the middle of the time that the track was seen.
        origin_s: f64,
        /// Unit of time; NaN: half of that time.
        unit_s: f64,
    },
    /// `1, cos(l omega t), sin(l omega t)`, `1 <= l <= order`.
    Fourier {
        /// Number of harmonics.
        order: usize,
        /// Angular frequency; NaN: it is found.
        omega_rad_s: f64,
    },
    /// B-splines of a degree over breaks that ascend, the outer ones repeated (de Boor 1978, chapter IX).
    Spline {
        /// Degree of the pieces.
        degree: usize,
        /// Where pieces begin and end.
        breaks_s: Vec<f64>,
    },
}

impl Form {
    /// Number of functions, which is the number of vectors of a path.
    pub fn len(&self) -> usize {
        match self {
            Self::Static => 1,
            Self::Taylor { order, .. } => order + 1,
            Self::Fourier { order, .. } => 2 * order + 1,
            Self::Spline { degree, breaks_s } => breaks_s.len() - 1 + degree,
        }
    }

    /// Never: every path has at least one vector.
    pub fn is_empty(&self) -> bool {
        false
    }

    /// The same with the time zero and unit that suit a track seen from `first_s` to `last_s`.
    #[must_use]
    pub fn over(&self, first_s: f64, last_s: f64) -> Self {
        match *self {
            Self::Taylor { order, origin_s, unit_s } => {
                let half = 0.5 * (last_s - first_s);
                Self::Taylor {
                    order,
                    origin_s: if origin_s.is_nan() { 0.5 * (first_s + last_s) } else { origin_s },
                    unit_s: if unit_s.is_nan() { if half > 0.0 { half } else { 1.0 } } else { unit_s },
                }
            }
            ref other => other.clone(),
        }
    }

    /// Values of the functions at a time, or of their derivative in time where `derivative` is 1.
    ///
    /// Beyond its outer breaks a spline is continued by its outermost pieces.
    pub fn values(&self, time_s: f64, derivative: usize, out: &mut [f64]) {
        match self {
            Self::Static => out[0] = if derivative == 0 { 1.0 } else { 0.0 },
            Self::Taylor { origin_s, unit_s, .. } => {
                powers((time_s - origin_s) / unit_s, 1.0 / unit_s, derivative, out)
            }
            Self::Fourier { omega_rad_s, .. } => harmonics(time_s, *omega_rad_s, derivative, out),
            Self::Spline { degree, breaks_s } => splines(time_s, *degree, breaks_s, derivative, out),
        }
    }
}

fn powers(s: f64, rate: f64, derivative: usize, out: &mut [f64]) {
    let mut power = 1.0;
    if derivative == 0 {
        for value in out {
            *value = power;
            power *= s;
        }
        return;
    }
    out[0] = 0.0;
    for (l, value) in out.iter_mut().enumerate().skip(1) {
        *value = l as f64 * power * rate;
        power *= s;
    }
}

fn harmonics(time_s: f64, omega: f64, derivative: usize, out: &mut [f64]) {
    out[0] = if derivative == 0 { 1.0 } else { 0.0 };
    for (l, pair) in out[1..].chunks_mut(2).enumerate() {
        let rate = (l + 1) as f64 * omega;
        let (sin, cos) = (rate * time_s).sin_cos();
        (pair[0], pair[1]) = if derivative == 0 { (cos, sin) } else { (-rate * sin, rate * cos) };
    }
}

/// Cox and de Boor's recursion; a derivative is `p (N_i / (t_{i+p} - t_i) - N_{i+1} / (t_{i+p+1} - t_{i+1}))` of one degree
/// less.
fn splines(time_s: f64, degree: usize, breaks: &[f64], derivative: usize, out: &mut [f64]) {
    let last = breaks.len() - 2;
    let piece = breaks[1..=last].partition_point(|&b| b <= time_s);
    let knot = |i: usize| breaks[i.saturating_sub(degree).min(last + 1)];
    let n = out.len();
    let lower = degree - derivative.min(degree);
    let mut value = vec![0.0; n + degree + 1];
    value[piece + degree] = 1.0;
    let ratio = |a: f64, b: f64| if b > 0.0 { a / b } else { 0.0 };
    for p in 1..=lower {
        for i in 0..n + degree - p {
            let rising = ratio(time_s - knot(i), knot(i + p) - knot(i));
            let falling = ratio(knot(i + p + 1) - time_s, knot(i + p + 1) - knot(i + 1));
            value[i] = rising * value[i] + falling * value[i + 1];
        }
    }
    if derivative == 0 {
        out.copy_from_slice(&value[..n]);
        return;
    }
    let p = degree as f64;
    for (i, out) in out.iter_mut().enumerate() {
        *out = ratio(p * value[i], knot(i + degree) - knot(i))
            - ratio(p * value[i + 1], knot(i + degree + 1) - knot(i + 1));
    }
}

#[cfg(test)]
mod tests {
    use super::Form;

    fn forms() -> Vec<Form> {
        vec![
            Form::Static,
            Form::Taylor { order: 3, origin_s: 1.5, unit_s: 2.0 },
            Form::Fourier { order: 3, omega_rad_s: 0.7 },
            Form::Spline { degree: 1, breaks_s: vec![0.0, 1.0, 3.0] },
            Form::Spline { degree: 3, breaks_s: vec![0.0, 1.0, 2.5, 3.0] },
            Form::Spline { degree: 2, breaks_s: vec![-1.0, 5.0] },
        ]
    }

    #[test]
    fn derivatives_are_those_of_differences() {
        for form in forms() {
            let n = form.len();
            for t in [0.1, 0.9, 1.7, 2.9] {
                let (mut plus, mut minus, mut slope) = (vec![0.0; n], vec![0.0; n], vec![0.0; n]);
                form.values(t + 1e-6, 0, &mut plus);
                form.values(t - 1e-6, 0, &mut minus);
                form.values(t, 1, &mut slope);
                for l in 0..n {
                    assert!(((plus[l] - minus[l]) / 2e-6 - slope[l]).abs() < 1e-8, "{form:?} at {t}, function {l}");
                }
            }
        }
    }

    #[test]
    fn splines_add_up_to_one_and_reach_the_ends() {
        for form in forms().into_iter().filter(|f| matches!(f, Form::Spline { .. })) {
            let n = form.len();
            let mut value = vec![0.0; n];
            for t in [0.0, 0.5, 1.0, 2.5, 3.0] {
                form.values(t, 0, &mut value);
                assert!((value.iter().sum::<f64>() - 1.0).abs() < 1e-14, "{form:?} at {t}: {value:?}");
            }
        }
        let form = Form::Spline { degree: 3, breaks_s: vec![0.0, 1.0, 2.0] };
        let mut value = [0.0; 5];
        form.values(0.0, 0, &mut value);
        assert_eq!(value, [1.0, 0.0, 0.0, 0.0, 0.0]);
        form.values(2.0, 0, &mut value);
        assert_eq!(value, [0.0, 0.0, 0.0, 0.0, 1.0]);
    }

    #[test]
    fn a_track_gets_a_time_of_its_own() {
        let free = Form::Taylor { order: 2, origin_s: f64::NAN, unit_s: f64::NAN };
        assert_eq!(free.over(2.0, 6.0), Form::Taylor { order: 2, origin_s: 4.0, unit_s: 2.0 });
        assert_eq!(free.over(2.0, 2.0), Form::Taylor { order: 2, origin_s: 2.0, unit_s: 1.0 });
    }
}
