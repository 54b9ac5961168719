// SPDX-License-Identifier: Apache-2.0
/// @file Runs jobs on the ranks of MPI_COMM_WORLD. Rank 0 distributes them; every rank runs them.
#pragma once

#include <vector>

#include "examples/evaluate_mpi/plan.hpp"

namespace app {

int rank_of_this_process();

/// Position among the ranks of one machine.
struct place {
  int rank;
  int ranks;
};
place place_of_this_rank();

/// Rank 0: gives each free rank, itself included, the next job. Reports progress on standard
/// output, failures on standard error. Returns when every job has ended.
/// @return 0 if all jobs ended with 0, else 1
int hand_out(std::vector<job> const& jobs);

/// Every other rank: runs jobs from rank 0 until there are no more. @return 0
int work(std::vector<job> const& jobs);

}  // namespace app
