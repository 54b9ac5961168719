// SPDX-License-Identifier: Apache-2.0
/// @file Jobs over the ranks of MPI_COMM_WORLD: rank 0 hands them out, every rank runs them.
#pragma once

#include <vector>

#include "examples/evaluate_mpi/plan.hpp"

namespace app {

int rank_of_this_process();

/// Among the ranks of one machine.
struct place {
  int rank;
  int ranks;
};
place place_of_this_rank();

/// Rank 0: gives each rank that is free, itself too, the next job, and reports progress on standard
/// output, failures on standard error. Returns when every job has ended.
/// @return 0 where all jobs ended with 0, else 1
int hand_out(std::vector<job> const& jobs);

/// Every other rank: runs what rank 0 hands out until there is no more. @return 0
int work(std::vector<job> const& jobs);

}  // namespace app
