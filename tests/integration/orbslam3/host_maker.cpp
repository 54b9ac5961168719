// SPDX-License-Identifier: Apache-2.0
// The unit that a user without CUDA has: one line.
#include "integration/orbslam3/make_tracker.hpp"
