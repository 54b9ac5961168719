// SPDX-License-Identifier: Apache-2.0
/// @file What ORB-SLAM3's Tracking.h needs of the shim: little, since all of the system includes
/// it.
#pragma once

#include <memory>  // of the tracker that Tracking owns

#include "integration/orbslam3/options.hpp"
#include "integration/orbslam3/settings_of.hpp"
