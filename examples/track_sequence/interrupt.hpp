// SPDX-License-Identifier: Apache-2.0
/// @file Ctrl-C as a question that the program answers between two frames.
#pragma once

namespace app {

/// From now on the first SIGINT and the first SIGTERM only let interrupted() say so. A second one
/// ends the program at once. A signal that the program was started to ignore stays ignored.
void watch_interrupts();

/// The name of the signal that came, or nullptr.
char const* interrupted();

}  // namespace app
