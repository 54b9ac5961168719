// SPDX-License-Identifier: Apache-2.0
#include "tests/consumers/link/units.hpp"

int first_unit() { return run_affine(ft::host_exec{}); }
