//! A package without code that `cargo xtask` names in every build.
//!
//! Cargo compiles an external package once for each set of features that the packages of one command ask for. With this
//! package among them the set is the same for the demo, the tests, the windows and a single package, so a build after
//! another one compiles only what is new. The feature `rest` adds the packages that the demo does not compile.
