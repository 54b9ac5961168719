// SPDX-License-Identifier: Apache-2.0
/// @file Distributes the jobs of a plan over MPI ranks: a free rank gets the next job. A job is a
/// command, run as a child process; rank 0 runs jobs as well. `tools/evaluation/evaluate.sh --mpi`
/// writes such plans; tools/evaluation/README.md describes the use on several hosts.
#include <mpi.h>

#include <CLI/CLI.hpp>

#include <cstdio>
#include <exception>
#include <string>
#include <vector>

#include "examples/evaluate_mpi/child.hpp"
#include "examples/evaluate_mpi/gpus.hpp"
#include "examples/evaluate_mpi/plan.hpp"
#include "examples/evaluate_mpi/ranks.hpp"

namespace {

/// The environment of this rank's jobs: its GPU, and how many ranks share the machine.
void set_environment(int gpus) {
  app::place const here = app::place_of_this_rank();
  setenv("FT_RANKS_ON_HOST", std::to_string(here.ranks).c_str(), 1);
  std::vector<std::string> const devices = app::visible_gpus(gpus);
  if (devices.empty()) { return; }
  auto const mine = static_cast<std::size_t>(here.rank) % devices.size();
  setenv("CUDA_VISIBLE_DEVICES", devices[mine].c_str(), 1);
}

int run(std::string const& path, int gpus) {
  std::vector<app::job> const jobs = app::read_plan(path);
  set_environment(gpus);
  return app::rank_of_this_process() == 0 ? app::hand_out(jobs) : app::work(jobs);
}

}  // namespace

int main(int argc, char** argv) {
  CLI::App cli("Runs the jobs of a plan on the ranks that mpirun starts.");
  std::string plan;
  int gpus = -1;
  cli.add_option("plan", plan, "JSON: [{\"name\": text, \"command\": [program, argument, ...]}]")
      ->required();
  cli.add_option("--gpus", gpus, "of each host; default: those of CUDA_VISIBLE_DEVICES, else all")
      ->check(CLI::NonNegativeNumber);
  MPI_Init(&argc, &argv);
  int status = 2;
  try {
    cli.parse(argc, argv);
    status = run(plan, gpus);
  } catch (CLI::ParseError const& e) { status = cli.exit(e); } catch (std::exception const& e) {
    std::fprintf(stderr, "evaluate_mpi: %s\n", e.what());
    MPI_Abort(MPI_COMM_WORLD, status);
  }
  MPI_Finalize();
  return status;
}
