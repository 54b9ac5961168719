// SPDX-License-Identifier: Apache-2.0
/// @file Options of a generated sequence, and the cameras that they make.
#pragma once

#include "examples/sequence/generator.hpp"
#include "examples/sequence/types.hpp"

namespace seq::generated {

/// With the defaults filled in. @throws seq::error for an option outside its range
generator_options complete(generator_options o);

stereo_rig make_rig(generator_options const& o);

}  // namespace seq::generated
