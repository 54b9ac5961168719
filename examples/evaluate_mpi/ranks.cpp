// SPDX-License-Identifier: Apache-2.0
#include "examples/evaluate_mpi/ranks.hpp"

#include <mpi.h>

#include <array>
#include <chrono>
#include <cstddef>
#include <cstdio>
#include <optional>
#include <thread>

#include "examples/evaluate_mpi/child.hpp"

namespace app {

namespace {

constexpr int no_job = -1;
constexpr int ended_tag = 1;  ///< to rank 0: a job and its status; no_job: only asks for a job
constexpr int job_tag = 2;    ///< from rank 0: the next job, or no_job

using ended_job = std::array<int, 2>;

/// Sleeps between polls. MPI's own waiting keeps a core busy, which would disturb the jobs'
/// timings.
void rest() { std::this_thread::sleep_for(std::chrono::milliseconds(5)); }

bool has_come(int source, int tag, MPI_Status& status) {
  int come = 0;
  MPI_Iprobe(source, tag, MPI_COMM_WORLD, &come, &status);
  return come != 0;
}

int ranks_in_all() {
  int ranks = 0;
  MPI_Comm_size(MPI_COMM_WORLD, &ranks);
  return ranks;
}

/// Rank 0's state of all jobs.
class dispatcher {
public:
  explicit dispatcher(std::vector<job> const& jobs) : jobs_(jobs), waiting_(ranks_in_all() - 1) {}

  int run() {
    std::printf("%zu jobs on %d ranks\n", jobs_.size(), waiting_ + 1);
    while (own_ || next_ < jobs_.size() || waiting_ > 0) {
      bool const answered = answer_a_rank();
      if (!run_own() && !answered) { rest(); }
    }
    if (failed_ > 0) { std::fprintf(stderr, "%d of %zu jobs failed\n", failed_, jobs_.size()); }
    return failed_ > 0 ? 1 : 0;
  }

private:
  int next_job() { return next_ < jobs_.size() ? static_cast<int>(next_++) : no_job; }

  /// Serves a rank that has ended a job, or asks for its first. @return whether there was one
  bool answer_a_rank() {
    MPI_Status from;
    if (!has_come(MPI_ANY_SOURCE, ended_tag, from)) { return false; }
    ended_job ended;
    MPI_Recv(ended.data(), 2, MPI_INT, from.MPI_SOURCE, ended_tag, MPI_COMM_WORLD,
             MPI_STATUS_IGNORE);
    if (ended[0] != no_job) { report(ended, from.MPI_SOURCE); }
    int const next = next_job();
    MPI_Send(&next, 1, MPI_INT, from.MPI_SOURCE, job_tag, MPI_COMM_WORLD);
    if (next == no_job) { --waiting_; }
    return true;
  }

  /// Starts or ends a job of this rank. @return whether it did either
  bool run_own() {
    if (!own_) {
      own_job_ = next_job();
      if (own_job_ == no_job) { return false; }
      own_.emplace(jobs_[static_cast<std::size_t>(own_job_)].command);
      return true;
    }
    auto const status = own_->status();
    if (!status) { return false; }
    report({own_job_, *status}, 0);
    own_.reset();
    return true;
  }

  void report(ended_job const& ended, int rank) {
    auto const& name = jobs_[static_cast<std::size_t>(ended[0])].name;
    ++done_;
    double const elapsed = MPI_Wtime() - start_;
    double const left =
        elapsed * static_cast<double>(jobs_.size() - done_) / static_cast<double>(done_);
    std::printf("[%zu/%zu] %s, rank %d%s; %.0f s in all, about %.0f s left\n", done_, jobs_.size(),
                name.c_str(), rank, ended[1] == 0 ? "" : " FAILED", elapsed, left);
    std::fflush(stdout);
    if (ended[1] == 0) { return; }
    ++failed_;
    std::fprintf(stderr, "FAILED: %s: ended with %d\n", name.c_str(), ended[1]);
  }

  std::vector<job> const& jobs_;
  int waiting_;  ///< other ranks that do not know yet that no job is left
  std::size_t next_ = 0;
  std::size_t done_ = 0;
  int failed_ = 0;
  std::optional<child> own_;
  int own_job_ = no_job;
  double start_ = MPI_Wtime();
};

}  // namespace

int rank_of_this_process() {
  int rank = 0;
  MPI_Comm_rank(MPI_COMM_WORLD, &rank);
  return rank;
}

place place_of_this_rank() {
  MPI_Comm machine;
  MPI_Comm_split_type(MPI_COMM_WORLD, MPI_COMM_TYPE_SHARED, 0, MPI_INFO_NULL, &machine);
  place here{};
  MPI_Comm_rank(machine, &here.rank);
  MPI_Comm_size(machine, &here.ranks);
  MPI_Comm_free(&machine);
  return here;
}

int hand_out(std::vector<job> const& jobs) { return dispatcher(jobs).run(); }

int work(std::vector<job> const& jobs) {
  ended_job ended{no_job, 0};
  for (;;) {
    MPI_Send(ended.data(), 2, MPI_INT, 0, ended_tag, MPI_COMM_WORLD);
    MPI_Status from;
    while (!has_come(0, job_tag, from)) { rest(); }
    int next = no_job;
    MPI_Recv(&next, 1, MPI_INT, 0, job_tag, MPI_COMM_WORLD, MPI_STATUS_IGNORE);
    if (next == no_job) { return 0; }
    child const process(jobs.at(static_cast<std::size_t>(next)).command);
    std::optional<int> status;
    while (!(status = process.status())) { rest(); }
    ended = {next, *status};
  }
}

}  // namespace app
