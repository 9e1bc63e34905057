//! Property tests that draw the same cases in every run.

use proptest::test_runner::{Config, RngSeed};

/// `proptest!` with a fixed seed. `PROPTEST_RNG_SEED` and `PROPTEST_CASES` select another seed and number of cases.
macro_rules! properties {
    (cases $cases:literal; $($tests:tt)*) => {
        proptest::proptest! {
            #![proptest_config($crate::properties::config($cases))]
            $($tests)*
        }
    };
    ($($tests:tt)*) => {
        properties! { cases 256; $($tests)* }
    };
}

/// Configuration with a fixed seed, unless the environment selects seed or number of cases.
pub fn config(cases: u32) -> Config {
    let mut config = Config::default();
    if config.rng_seed == RngSeed::Random {
        config.rng_seed = RngSeed::Fixed(20240229);
    }
    if std::env::var_os("PROPTEST_CASES").is_none() {
        config.cases = cases;
    }
    config.max_global_rejects = config.max_global_rejects.max(4 * config.cases);
    config
}
