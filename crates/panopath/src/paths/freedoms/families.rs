//! Functions of time that names are given for: powers, harmonics, splines, in the order in which they are tried.

use super::super::Form;
use super::TimeFunction;
use super::part::Part;

/// Most functions that are tried.
const MOST: usize = 64;

/// One step of the series: functions over all views of a part, with their name.
pub(super) struct Family {
    pub name: TimeFunction,
    /// One list of values, over the nodes, for each function.
    pub functions: Vec<Vec<f64>>,
}

/// Families of the forms of a part's tracks: the constant first, then what can be named most simply.
pub(super) fn of_part<const D: usize>(part: &Part<D>, forms: &[Form]) -> Vec<Family> {
    let times = &part.time_s;
    let (first, last) = times.iter().fold((f64::INFINITY, f64::NEG_INFINITY), |(a, b), &t| (a.min(t), b.max(t)));
    let half = if last > first { 0.5 * (last - first) } else { 1.0 };
    let mut families = vec![Family { name: TimeFunction::Any, functions: vec![vec![1.0; times.len()]] }];
    let mut order = 0;
    let (mut waves, mut splines): (Vec<(f64, usize)>, Vec<(u32, &Form)>) = (Vec::new(), Vec::new());
    for &track in &part.tracks {
        match &forms[track as usize] {
            Form::Static => {}
            Form::Taylor { order: k, .. } => order = order.max(*k),
            Form::Fourier { order: k, omega_rad_s } => match waves.iter_mut().find(|wave| wave.0 == *omega_rad_s) {
                Some(wave) => wave.1 = wave.1.max(*k),
                None => waves.push((*omega_rad_s, *k)),
            },
            spline @ Form::Spline { degree, .. } => {
                order = order.max(*degree);
                if splines.len() < MOST && !splines.iter().any(|other| other.1 == spline) {
                    splines.push((track, spline));
                }
            }
        }
    }
    for l in 1..=order {
        let power = times.iter().map(|t| ((t - first - half) / half).powi(l as i32)).collect();
        families.push(Family { name: TimeFunction::Power(l), functions: vec![power] });
    }
    for (omega, k) in waves {
        for l in 1..=k {
            let rate = l as f64 * omega;
            let pair =
                [times.iter().map(|t| (rate * t).cos()).collect(), times.iter().map(|t| (rate * t).sin()).collect()];
            families.push(Family { name: TimeFunction::Harmonic(l, omega), functions: pair.to_vec() });
        }
    }
    for (track, form) in splines {
        let mut functions = vec![vec![0.0; times.len()]; form.len()];
        let mut row = vec![0.0; form.len()];
        for (node, &t) in times.iter().enumerate() {
            form.values(t, 0, &mut row);
            functions.iter_mut().zip(&row).for_each(|(f, value)| f[node] = *value);
        }
        families.push(Family { name: TimeFunction::SplineOf(track), functions });
    }
    let mut count = 0;
    families.retain(|family| {
        count += family.functions.len();
        count <= MOST
    });
    families
}
