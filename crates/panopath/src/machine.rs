//! What the processor offers, and what this library takes of it: for reports, not for numbers, which are the same.

/// Vector instructions that the inner loops use on this machine.
///
/// The choice is made when the program runs: `"avx512"`, `"avx2"`, `"neon"` or `"none"`.
#[must_use]
pub fn vector_instructions() -> &'static str {
    chosen(pulp::Arch::new())
}

#[cfg(target_arch = "x86_64")]
fn chosen(arch: pulp::Arch) -> &'static str {
    match arch {
        pulp::Arch::V4(_) => "avx512",
        pulp::Arch::V3(_) => "avx2",
        _ => "none",
    }
}

#[cfg(target_arch = "aarch64")]
fn chosen(arch: pulp::Arch) -> &'static str {
    match arch {
        pulp::Arch::Neon(_) => "neon",
        _ => "none",
    }
}

#[cfg(not(any(target_arch = "x86_64", target_arch = "aarch64")))]
fn chosen(_: pulp::Arch) -> &'static str {
    "none"
}

/// Threads that a step uses where it is not told how many.
#[must_use]
pub fn default_threads() -> usize {
    rayon::current_num_threads()
}

#[cfg(test)]
mod tests {
    #[test]
    fn what_is_chosen_is_there() {
        let chosen = super::vector_instructions();
        assert!(["avx512", "avx2", "neon", "none"].contains(&chosen));
        #[cfg(target_arch = "x86_64")]
        assert_eq!(chosen == "none", !std::arch::is_x86_feature_detected!("avx2"));
        assert!(super::default_threads() >= 1);
    }
}
