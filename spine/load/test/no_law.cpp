// SPDX-License-Identifier: Apache-2.0
// For loader_test: a shared object that is no law.
extern "C" __attribute__((visibility("default"))) int not_a_law() { return 0; }
