// SPDX-License-Identifier: Apache-2.0
#include "integration/orbslam3/make_tracker.hpp"
