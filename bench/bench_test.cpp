// SPDX-License-Identifier: Apache-2.0
// Tests the bench's own rules, and that it times real work: frames whose keypoints are matched and
// whose poses are found, points that the cameras see.
#include <gtest/gtest.h>

#include <cstdlib>
#include <ostream>
#include <set>
#include <stdexcept>
#include <string>
#include <vector>

#include "bench/host_stages.hpp"
#include "bench/names.hpp"
#include "bench/plan.hpp"
#include "bench/runner.hpp"
#include "bench/scene.hpp"

namespace bench {
void PrintTo(rig_type rig, std::ostream* out) { *out << name_of(rig); }
}  // namespace bench

namespace bench_test {

using bench::backend_type;
using bench::rig_type;

TEST(sections, none_given_means_all) {
  auto const all = bench::parse_sections({});
  EXPECT_EQ(all.size(), bench::all_sections().size());
  EXPECT_EQ(all.count("fisheye"), 1u);
}

TEST(sections, are_taken_from_lists_and_from_several_options) {
  EXPECT_EQ(bench::parse_sections({"frame,batch", "cameras", "frame"}),
            (std::set<std::string>{"batch", "cameras", "frame"}));
}

TEST(sections, a_name_that_is_none_is_refused_with_those_there_are) {
  for (char const* wrong : {"frames", "", "frame,", ",frame", "frame batch", "Frame"}) {
    try {
      bench::parse_sections({wrong});
      FAIL() << "'" << wrong << "' was taken";
    } catch (std::runtime_error const& e) {
      EXPECT_NE(std::string(e.what()).find("ablation"), std::string::npos) << e.what();
    }
  }
}

TEST(plan, batches_get_fewer_calls_the_larger_they_are) {
  EXPECT_EQ(bench::calls_of_batch(250, 1), 250);
  EXPECT_EQ(bench::calls_of_batch(250, 16), 250);
  EXPECT_EQ(bench::calls_of_batch(250, 64), 62);
  EXPECT_EQ(bench::calls_of_batch(250, 256), 24);
  EXPECT_EQ(bench::calls_of_batch(4, 256), 4);  // never more calls than for one pair
  EXPECT_EQ(bench::calls_of_batch(1 << 24, 1), 1 << 24);
}

TEST(plan, shares_cover_all_items_once_and_differ_by_one_at_most) {
  for (int items : {0, 1, 7, 64}) {
    for (int parts : {1, 2, 3, 16}) {
      int next = 0;
      for (int p = 0; p < parts; ++p) {
        auto const share = bench::share_of(items, parts, p);
        EXPECT_EQ(share.first, next);
        EXPECT_GE(share.second - share.first, items / parts);
        EXPECT_LE(share.second - share.first, items / parts + 1);
        next = share.second;
      }
      EXPECT_EQ(next, items);
    }
  }
}

TEST(plan, the_rate_is_that_of_the_ends_without_the_first_fifth) {
  // Ten frames that end 100 us apart, in no order; the first two were slow.
  std::vector<bench::finished_frame> frames;
  for (int i : {3, 0, 9, 1, 5, 4, 8, 7, 2, 6}) {
    frames.push_back({1000.0 + 100 * i, i < 2 ? 900.0 : 40.0 + i});
  }
  std::vector<double> took{1, 2, 3};
  EXPECT_DOUBLE_EQ(bench::steady_rate(frames, took), 10000);
  ASSERT_EQ(took.size(), 8u);
  EXPECT_DOUBLE_EQ(took.front(), 42);
  EXPECT_DOUBLE_EQ(took.back(), 49);
}

TEST(plan, no_rate_from_fewer_than_two_frames) {
  std::vector<bench::finished_frame> frames;
  std::vector<double> took{1};
  EXPECT_EQ(bench::steady_rate(frames, took), 0);
  EXPECT_TRUE(took.empty());
  frames = {{5, 2}};
  EXPECT_EQ(bench::steady_rate(frames, took), 0);
  EXPECT_EQ(took.size(), 1u);
  frames = {{5, 2}, {5, 3}};
  EXPECT_EQ(bench::steady_rate(frames, took), 0);  // no time passed
}

TEST(names, of_kernels_are_functor_and_shape) {
  EXPECT_EQ(bench::short_kernel_name(
                "void ft::v0_cuda::detail::per_block_kernel<512, ft::v0_cuda::assign<ft::v0_cuda::"
                "rig, true>, int, char const*>(T2, T3...)"),
            "assign<rig, true> (per_block)");
  EXPECT_EQ(bench::short_kernel_name(
                "void ft::v0_cuda::detail::per_warp_kernel<(int)4, ft::v0_cuda::list, int>(int)"),
            "list (per_warp)");
  EXPECT_EQ(bench::short_kernel_name("void detail::per_thread_kernel<128, op>(int)"),
            "op (per_thread)");
  EXPECT_EQ(bench::short_kernel_name("another(int)"), "another(int)");
  EXPECT_EQ(bench::short_kernel_name(""), "");
}

std::vector<backend_type> backends() {
  std::vector<backend_type> all{backend_type::host};
  if (!bench::cuda_description().empty()) {
    all.push_back(backend_type::cuda);
  } else if (char const* const require = std::getenv("FT_REQUIRE_GPU");
             require != nullptr && std::string(require) == "1") {
    ADD_FAILURE() << "FT_REQUIRE_GPU=1 but there is no CUDA device";
  }
  return all;
}

class frames : public ::testing::TestWithParam<rig_type> {};
INSTANTIATE_TEST_SUITE_P(rigs, frames, ::testing::Values(rig_type::rectified, rig_type::fisheye),
                         [](auto const& rig) { return std::string(name_of(rig.param)); });

TEST_P(frames, are_matched_and_their_poses_found) {
  bench::scene const s = bench::make_scene(GetParam(), 376, 0, 4, 500, 600);
  for (auto const b : backends()) {
    SCOPED_TRACE(name_of(b));
    bench::frame_options o;
    o.backend = b;
    o.batch = 2;
    auto const runner = bench::make_frame_runner(s, o);
    auto const c = runner->counts();
    EXPECT_GT(runner->map_points(), 300);
    EXPECT_LE(runner->map_points(), 600);
    EXPECT_GT(c.keypoints, 400);
    EXPECT_GT(c.stereo_matches, 60);
    EXPECT_LT(c.stereo_matches, c.keypoints);
    EXPECT_GT(c.last_matches, 30);
    EXPECT_GT(c.inliers, 80);
    EXPECT_LE(c.last_inliers, c.last_matches);
    EXPECT_LT(c.position_error, 0.03);  // the prediction is off by 0.014
  }
}

TEST_P(frames, stages_are_all_timed_and_both_calls_run) {
  bench::scene const s = bench::make_scene(GetParam(), 376, 0, 3, 300, 300);
  for (auto const b : backends()) {
    SCOPED_TRACE(name_of(b));
    bench::frame_options o;
    o.backend = b;
    o.measure_stages = true;
    auto const runner = bench::make_frame_runner(s, o);
    auto const times = runner->stage_times(1);
    ASSERT_EQ(times.size(), 13u);
    EXPECT_EQ(times.front().name, "upload");
    EXPECT_EQ(times.back().name, "result");
    for (auto const& t : times) { EXPECT_GE(t.us, 0) << t.name; }
    for (auto how : {bench::call_type::whole, bench::call_type::two_halves}) {
      runner->prepare(2);
      runner->update_map(runner->map_points());
      runner->update_positions(runner->map_points());
      runner->launch(how);
      runner->wait();
      EXPECT_TRUE(runner->done());
    }
  }
}

TEST_P(frames, recorded_work_is_counted) {
  bench::scene const s = bench::make_scene(GetParam(), 376, 0, 2, 300, 300);
  for (auto const b : backends()) {
    SCOPED_TRACE(name_of(b));
    bench::frame_options o;
    o.backend = b;
    o.use_graphs = false;
    auto const runner = bench::make_frame_runner(s, o);
    auto const g = runner->graph();
    auto const kernels = runner->kernels();
    if (b == backend_type::host) {
      EXPECT_EQ(g.kernels + g.copies + g.fills + g.others, 0);
      EXPECT_TRUE(kernels.empty());
      continue;
    }
    auto const images = 2u * static_cast<unsigned>(s.width) * static_cast<unsigned>(s.height);
    EXPECT_GE(g.bytes_up, images);
    EXPECT_LT(g.bytes_up, 2 * images + (1u << 20));
    int launches = 0;
    for (auto const& k : kernels) {
      launches += k.launches;
      EXPECT_FALSE(k.name.empty());
      EXPECT_GT(k.registers, 0) << k.name;
      EXPECT_GT(k.threads_per_sm, 0) << k.name;
    }
    EXPECT_EQ(launches, g.kernels);
    EXPECT_GT(g.result_bytes, 300u * 36u);
  }
}

TEST(host_stages, run_on_every_pair_and_have_their_counterparts) {
  bench::scene const s = bench::make_scene(rig_type::rectified, 376, 0, 2, 300, 300);
  auto const stages = bench::make_host_stages(s);
  bool const opencv = !bench::opencv_description().empty();
  std::set<std::string> names;
  int counterparts = 0;
  for (int pair = 0; pair < 2; ++pair) {
    stages->prepare(pair);
    for (auto const& stage : stages->all()) {
      names.insert(stage.name);
      stage.ours();
      if (!stage.theirs) { continue; }
      stage.theirs();
      ++counterparts;
      EXPECT_FALSE(stage.counterpart.empty()) << stage.name;
      EXPECT_FALSE(stage.difference.empty()) << stage.name;
    }
  }
  EXPECT_EQ(names.size(), stages->all().size());
  EXPECT_EQ(counterparts, opencv ? 2 * 9 : 0);
}

TEST(cameras, see_every_point_that_they_are_timed_on) {
  for (auto const b : backends()) {
    auto const runner = bench::make_camera_runner(b, 1, 2000, 2);
    auto const& cases = runner->cases();
    ASSERT_EQ(cases.size(), 9u * 2 * 3 + 1);
    for (std::size_t k = 0; k < cases.size(); ++k) {
      runner->select(static_cast<int>(k));
      EXPECT_GE(runner->run(1, 3), 0);
      EXPECT_GT(runner->valid_share(), 0.995)
          << name_of(b) << " " << cases[k].model << " " << cases[k].scalar << " " << cases[k].op;
    }
  }
}

TEST(matching, finds_the_rows_that_are_alike) {
  for (auto const backend : backends()) {
    for (char const* const model : bench::matching_models) {
      auto const runner = bench::make_matching_runner({backend, 2, model, 300, true});
      EXPECT_GT(runner->run(), 0);
      EXPECT_NEAR(runner->matched_share(), 0.5, 0.02) << model;
    }
  }
}

TEST(windows, are_adjusted) {
  for (auto const b : backends()) {
    bench::window_case what;
    what.backend = b;
    what.batch = 2;
    what.points = 200;
    auto const runner = bench::make_window_runner(what);
    for (int again = 0; again < 2; ++again) {  // each time from the start
      EXPECT_GE(runner->run(), 0);
      EXPECT_GT(runner->gained(), 0.1) << name_of(b);
    }
  }
}

TEST(inertial, poses_are_found) {
  for (auto const b : backends()) {
    for (bool const last : {false, true}) {
      bench::inertial_case what;
      what.backend = b;
      what.problems = 2;
      what.from_last_frame = last;
      auto const runner = bench::make_inertial_runner(what);
      for (int again = 0; again < 2; ++again) {  // each time from the start
        EXPECT_GE(runner->run(), 0);
        EXPECT_NEAR(runner->inlier_share(), 0.9, 0.05) << name_of(b);
      }
    }
    bench::inertial_case integrals;
    integrals.backend = b;
    integrals.problems = 20;
    integrals.observations = 0;
    EXPECT_GE(bench::make_inertial_runner(integrals)->run(), 0);
  }
}

TEST(words, stages_find_what_their_inputs_show) {
  using bench::words_stage;
  for (auto const b : backends()) {
    bench::words_case what;
    what.backend = b;
    what.levels = 4;
    for (auto const stage :
         {words_stage::transform, words_stage::query, words_stage::search, words_stage::solve,
          words_stage::relocalize, words_stage::two_views, words_stage::start}) {
      what.stage = stage;
      // Scores of an earlier query count, so places are further apart than neighbours.
      what.count = stage == words_stage::query ? 200 : 3;
      auto const runner = bench::make_words_runner(what);
      for (int i = 0; i < bench::words_runner::inputs + 1; ++i) {
        EXPECT_GE(runner->run(), 0);
        int found = 0;
        EXPECT_NO_THROW(found = runner->found()) << name_of(b) << " " << static_cast<int>(stage);
        EXPECT_GT(found, 0);
      }
    }
  }
}

}  // namespace bench_test
