// SPDX-License-Identifier: Apache-2.0
// Compares every stage with recorded answers: one golden folder, or a folder of such folders.
#include <CLI/CLI.hpp>
#include <algorithm>
#include <cstdio>
#include <cstdlib>
#include <filesystem>
#include <fstream>
#include <iostream>
#include <iterator>
#include <map>
#include <nlohmann/json.hpp>
#include <string>
#include <vector>

#include "tests/conformance/backends.hpp"

namespace {

/// Whether a folder holds a golden sequence, a golden case, or what golden_words has.
bool is_golden(std::filesystem::path const& folder) {
  return std::filesystem::exists(folder / "params.json") ||
         std::filesystem::exists(folder / "case.json") ||
         std::filesystem::is_directory(folder / "two_view");
}

std::vector<std::string> folders_of(std::string const& root) {
  namespace fs = std::filesystem;
  if (!fs::is_directory(root)) { throw std::runtime_error("no folder '" + root + "'"); }
  if (is_golden(root)) { return {root}; }
  std::vector<std::string> found;
  for (auto const& entry : fs::directory_iterator(root)) {
    if (is_golden(entry.path())) { found.push_back(entry.path().string()); }
  }
  std::sort(found.begin(), found.end());
  if (found.empty()) {
    throw std::runtime_error("no params.json or case.json in '" + root +
                             "' or in a folder below it");
  }
  return found;
}

constexpr int skipped = 77;

/// Where recorded answers are by default: sequences, cases of the tie rule std_sort, IMUs, and
/// words; those of them that are there. None where there are no sequences.
std::vector<std::string> default_roots() {
  char const* const data = std::getenv("FT_DATA");
  std::string const root = data == nullptr ? "../shared" : data;
  if (!std::filesystem::is_directory(root + "/golden")) { return {}; }
  std::vector<std::string> roots{root + "/golden"};
  auto const add = [&](std::string const& folder, char const* what) {
    if (std::filesystem::is_directory(folder)) {
      roots.push_back(folder);
    } else {
      std::cerr << "conformance: no folder '" << folder << "': " << what << " skipped\n";
    }
  };
  add(root + "/golden_std_sort", "the tie rule std_sort is");
  add(root + "/golden_inertial", "the inertial stages are");
  add(root + "/golden_words", "the stages of words and recovery are");
  return roots;
}

char const* const all_stages[] = {"pyramid",
                                  "corners",
                                  "distribution",
                                  "orientation",
                                  "blur",
                                  "descriptor",
                                  "keypoint_order",
                                  "grid",
                                  "stereo_rectified",
                                  "stereo_fisheye",
                                  "search_last_frame",
                                  "frustum",
                                  "search_local_map",
                                  "pose_optimization",
                                  "end_to_end"};
/// Of folders that have them.
char const* const inertial_stages[] = {
    "imu_samples",   "preintegration", "integral_derivatives", "integral_covariance",
    "changed_bias",  "imu_prediction", "imu_information",      "inertial_pose_flags",
    "inertial_pose", "inertial_prior", "inertial_pose_chained"};

char const* const words_stages[] = {"counter_draws",      "vocabulary_text",
                                    "transform_features", "transform_bag",
                                    "transform_groups",   "pnp_rays",
                                    "pnp_limits",         "pnp_poses",
                                    "pnp_counts",         "pnp_calls",
                                    "pnp_call_poses",     "pnp_refined",
                                    "word_scoring",       "database_common",
                                    "database_score",     "database_query",
                                    "two_view",           "two_view_scores",
                                    "two_view_motion",    "two_view_points",
                                    "search_by_words",    "search_initial_matches",
                                    "search_keyframe",    "relocalize",
                                    "relocalize_pose",    "monocular_start"};

/// Recorded answers of two views that lie outside FORMAT.md's tolerances, where the reference's F
/// from a sample in float is not that of a solver in double: the ratio of the scores of
/// synth_plane_H (2.2e-5 for 1e-5) and of t265_0_1 (1.01e-5), and a point of kitti_0_1 at 255
/// baselines (1.5e-3 for 1e-3). They are counted as different, and say so.
std::map<std::string, long> const known_differences = {{"two_view_scores", 2},
                                                       {"two_view_points", 1}};

/// The stages that recorded answers in these folders are of.
std::vector<std::string> needed_stages(std::vector<std::string> const& folders) {
  std::vector<std::string> names(std::begin(all_stages), std::end(all_stages));
  bool const inertial = std::any_of(folders.begin(), folders.end(), [](std::string const& f) {
    return std::filesystem::exists(f + "/pf_dT.npy");
  });
  if (inertial) {
    names.insert(names.end(), std::begin(inertial_stages), std::end(inertial_stages));
  }
  bool const words = std::any_of(folders.begin(), folders.end(), [](std::string const& f) {
    return std::filesystem::is_directory(f + "/two_view");
  });
  if (words) { names.insert(names.end(), std::begin(words_stages), std::end(words_stages)); }
  return names;
}

int run(std::vector<std::string> roots, std::string const& backend, std::string const& json,
        bool need_all) {
  if (roots.empty()) { roots = default_roots(); }
  if (roots.empty()) {
    std::cerr << "conformance: skipped: no recorded answers here; set FT_DATA to the folder that "
                 "holds golden/, or "
                 "give --golden\n";
    return skipped;
  }
  char const* const require = std::getenv("FT_REQUIRE_GPU");
  if (backend == "cuda" && !conformance::cuda_available() &&
      (require == nullptr || std::string(require) != "1")) {
    std::cerr << "conformance: skipped: no CUDA device\n";
    return skipped;
  }
  conformance::table all;
  std::vector<std::string> folders;
  for (auto const& root : roots) {
    auto const found = folders_of(root);
    folders.insert(folders.end(), found.begin(), found.end());
  }
  for (auto const& folder : folders) {
    std::cerr << "compare " << folder << "\n";
    auto const table =
        backend == "cuda" ? conformance::run_cuda(folder) : conformance::run_host(folder);
    for (auto const& [name, f] : table) {
      auto& sum = all[name];
      sum.items += f.items;
      sum.identical += f.identical;
      sum.max_abs_diff = std::max(sum.max_abs_diff, f.max_abs_diff);
    }
  }
  nlohmann::json out;
  out["backend"] = backend;
  long items = 0;
  long identical = 0;
  long expected = 0;  // differences that are known
  std::printf("%-22s %12s %12s %10s %16s\n", "stage", "items", "identical", "share",
              "worst difference");
  for (auto const& [name, f] : all) {
    if (f.items == 0) { continue; }  // the folder lacks it
    double const share = static_cast<double>(f.identical) / static_cast<double>(f.items);
    std::printf("%-22s %12ld %12ld %9.4f%% %16.3g\n", name.c_str(), f.items, f.identical,
                100 * share, f.max_abs_diff);
    out["stages"][name] = {{"items", f.items},
                           {"identical", f.identical},
                           {"share", share},
                           {"max_abs_diff", f.max_abs_diff}};
    auto const known = known_differences.find(name);
    if (known != known_differences.end() && f.items - f.identical <= known->second) {
      expected += f.items - f.identical;
    }
    items += f.items;
    identical += f.identical;
  }
  std::printf("%-22s %12ld %12ld\n", "total", items, identical);
  out["items"] = items;
  out["identical"] = identical;
  if (!json.empty()) {
    std::ofstream file(json);
    file << out.dump(2) << "\n";
    if (!file) { throw std::runtime_error("cannot write '" + json + "'"); }
  }
  bool complete = true;
  for (auto const& stage : needed_stages(folders)) {
    if (need_all && all[stage].items == 0) {
      std::cerr << "conformance: no item of stage " << stage << " was compared\n";
      complete = false;
    }
  }
  if (expected > 0) { std::printf("known differences      %12ld\n", expected); }
  return identical + expected == items && complete ? 0 : 1;
}

}  // namespace

int main(int argc, char** argv) {
  std::vector<std::string> golden;
  std::string backend = "host";
  std::string json;
  bool need_all = false;
  CLI::App app(
      "Runs every stage of ft on recorded inputs and counts the answers that are identical.");
  app.add_option("--golden", golden,
                 "a golden folder, or a folder of them; several may be given; default: "
                 "$FT_DATA/golden, golden_std_sort, golden_inertial and golden_words");
  app.add_option("--backend", backend, "host or cuda")
      ->check(CLI::IsMember({"host", "cuda"}))
      ->capture_default_str();
  app.add_option("--json", json, "also write the table to this file");
  app.add_flag("--all-stages", need_all, "fail where a stage has nothing to compare");
  CLI11_PARSE(app, argc, argv);
  try {
    return run(golden, backend, json, need_all);
  } catch (std::exception const& e) {
    std::cerr << "conformance: " << e.what() << "\n";
    return 2;
  }
}
