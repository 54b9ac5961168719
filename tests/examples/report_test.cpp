// SPDX-License-Identifier: Apache-2.0
// What is computed of a run, and summary.json.
#include <gtest/gtest.h>

#include <algorithm>
#include <cstddef>
#include <nlohmann/json.hpp>
#include <sstream>
#include <string>
#include <vector>

#include "examples/sequence/report.hpp"
#include "examples/sequence/warnings.hpp"
#include "tests/support/report_markup.hpp"
#include "tests/support/report_runs.hpp"

namespace report_test {

TEST_F(report, statistics_match_numbers_by_hand) {
  seq::statistics const s =
      seq::summarise({9, 2, 4, 4, 4, 5, 5, 7});  // the textbook example: std 2
  EXPECT_DOUBLE_EQ(s.mean, 5);
  EXPECT_DOUBLE_EQ(s.std, 2);
  EXPECT_DOUBLE_EQ(s.p50, 4);  // the 4th of 8
  EXPECT_DOUBLE_EQ(s.p99, 9);
  EXPECT_DOUBLE_EQ(s.max, 9);
}

TEST_F(report, how_a_run_was_made_is_in_all_its_files) {
  seq::run_report r;
  r.backend = "host";
  r.version = "1.2.3";
  r.date = seq::utc_now();
  r.threads = 7;
  r.command = seq::command_line({"track_sequence", "my folder", "--out=a", "it's"});
  EXPECT_EQ(r.command, "track_sequence 'my folder' --out=a 'it'\\''s'");
  EXPECT_EQ(r.date.size(), 20u);
  EXPECT_EQ(r.date[10], 'T');
  EXPECT_EQ(r.date.back(), 'Z');
  r.error.drift_percent = 1.25;
  r.error.ate_axes_m = Eigen::Vector3d(0.1, 0.2, 0.3);
  auto const json = summary(r);
  EXPECT_EQ(json.at("version"), "1.2.3");
  EXPECT_EQ(json.at("date"), r.date);
  EXPECT_EQ(json.at("threads"), 7);
  EXPECT_EQ(json.at("command"), r.command);
  EXPECT_EQ(json.at("drift_percent"), 1.25);
  EXPECT_EQ(json.at("ate_axes_m"), (nlohmann::json{0.1, 0.2, 0.3}));
  std::string const page = html(r);
  for (char const* part : {"1.2.3", "my folder", "threads</th><td>7"}) {
    EXPECT_NE(page.find(part), std::string::npos) << part;
  }
  EXPECT_NE(page.find(r.date), std::string::npos);
  std::ostringstream printed;
  seq::print_summary(printed, r);
  EXPECT_NE(printed.str().find("x 0.1000, y 0.2000, z 0.3000 m"), std::string::npos);
  EXPECT_NE(printed.str().find("1.25 % of"), std::string::npos);
}

TEST_F(report, percentiles_are_nearest_rank) {
  std::vector<double> samples;
  for (int i = 200; i >= 1; --i) { samples.push_back(i); }
  seq::statistics const s = seq::summarise(samples);
  EXPECT_DOUBLE_EQ(s.p50, 100);  // rank ceil(0.5 * 200)
  EXPECT_DOUBLE_EQ(s.p99, 198);  // rank ceil(0.99 * 200)
  EXPECT_DOUBLE_EQ(s.mean, 100.5);
  samples.push_back(201);
  EXPECT_DOUBLE_EQ(seq::summarise(samples).p50, 101);
  EXPECT_DOUBLE_EQ(seq::summarise(samples).p99, 199);  // ceil(198.99)
}

TEST_F(report, statistics_of_none_one_and_unusable_samples) {
  for (auto const& samples : {std::vector<double>{}, std::vector<double>{nan_value, inf_value}}) {
    seq::statistics const s = seq::summarise(samples);
    EXPECT_EQ(s.mean, 0);
    EXPECT_EQ(s.std, 0);
    EXPECT_EQ(s.p50, 0);
    EXPECT_EQ(s.p99, 0);
    EXPECT_EQ(s.max, 0);
  }
  seq::statistics const s = seq::summarise({nan_value, -3, inf_value});
  EXPECT_EQ(s.mean, -3);
  EXPECT_EQ(s.std, 0);
  EXPECT_EQ(s.p50, -3);
  EXPECT_EQ(s.max, -3);
}

TEST_F(report, standard_deviation_survives_a_large_mean) {
  EXPECT_NEAR(seq::summarise({1e9 + 1, 1e9 + 3}).std, 1, 1e-6);
}

TEST_F(report, json_holds_every_key) {
  nlohmann::json const j = summary(filled(20, true));
  for (char const* key :
       {"title",        "sequence",   "backend",    "device",       "image_width",
        "image_height", "frames",     "tracked",    "lost",         "dropped",
        "keyframes",    "map_points", "path_m",     "truth_path_m", "estimate_path_m",
        "pairs",        "ate_rmse_m", "rpe_rmse_m", "mean_inliers", "mean_keypoints",
        "fps",          "stages",     "options"}) {
    EXPECT_TRUE(j.contains(key)) << key;
  }
  EXPECT_EQ(j["frames"], 20);
  EXPECT_EQ(j["tracked"], 18);
  EXPECT_EQ(j["lost"], 2);
  EXPECT_EQ(j["keyframes"], 4);
  EXPECT_EQ(j["backend"], "host");
  EXPECT_EQ(j["options"]["levels"], "8");
  EXPECT_DOUBLE_EQ(j["path_m"], 12.5);
  EXPECT_DOUBLE_EQ(j["truth_path_m"], 12.25);
  EXPECT_DOUBLE_EQ(j["ate_rmse_m"], 0.05);
  EXPECT_DOUBLE_EQ(j["rpe_rmse_m"], 0.025);
  EXPECT_DOUBLE_EQ(j["mean_keypoints"], 1000);
  // the total is 4 for the ten even frames, 5 for nine odd ones, 400 for frame 3
  EXPECT_NEAR(j["fps"], 20 / ((10 * 4.0 + 9 * 5.0 + 400.0) / 1000), 1e-9);
  ASSERT_EQ(j["stages"].size(), 3U);
  for (char const* stage : {"fast", "match", "total"}) {
    for (char const* key : {"mean_ms", "std_ms", "p50_ms", "p99_ms", "max_ms"}) {
      EXPECT_TRUE(j["stages"][stage][key].is_number()) << stage << ' ' << key;
    }
  }
  EXPECT_DOUBLE_EQ(j["stages"]["match"]["mean_ms"], 2);
  EXPECT_DOUBLE_EQ(j["stages"]["total"]["max_ms"], 400);
}

TEST_F(report, the_time_from_images_to_pose_leads) {
  seq::run_report r = filled(20, true);
  EXPECT_TRUE(summary(r)["images_to_pose"].is_null());  // not measured
  for (auto& f : r.records) { f.images_to_pose_ms = 20 + f.index; }
  r.wall_s = 2;
  nlohmann::json j = summary(r);
  EXPECT_DOUBLE_EQ(j["images_to_pose"]["mean_ms"], 29.5);
  EXPECT_DOUBLE_EQ(j["images_to_pose"]["p50_ms"], 29);
  EXPECT_DOUBLE_EQ(j["images_to_pose"]["p99_ms"], 39);
  EXPECT_EQ(j["prefetch"], 0);
  EXPECT_TRUE(j["fps"].is_number());
  auto const printed = [](seq::run_report const& of) {
    std::ostringstream out;
    seq::print_summary(out, of);
    return out.str();
  };
  EXPECT_LT(printed(r).find("images to pose    p50 29.000 ms"), printed(r).find("stage "));
  EXPECT_EQ(printed(r).find("given ahead"), std::string::npos);
  EXPECT_NE(printed(r).find("tracking alone"), std::string::npos);
  EXPECT_NE(html(r).find("Images to pose"), std::string::npos);

  r.prefetch = 4;
  j = summary(r);
  EXPECT_EQ(j["prefetch"], 4);
  // The stages leave out what is computed ahead: no rate follows from them.
  EXPECT_TRUE(j["fps"].is_null());
  EXPECT_TRUE(j["processing_s"].is_null());
  EXPECT_DOUBLE_EQ(j["wall_fps"], 10);
  EXPECT_NE(printed(r).find("up to 4 frames are given ahead"), std::string::npos);
  EXPECT_EQ(printed(r).find("tracking alone"), std::string::npos);
  EXPECT_EQ(html(r).find("tracking alone"), std::string::npos);
  EXPECT_NE(html(r).find("up to 4 frames given ahead"), std::string::npos);
  EXPECT_EQ(markup_fault(html(r)), "");
}

TEST_F(report, reasons_are_counted_and_missing_figures_say_why) {
  seq::run_report r = filled(20, true);
  EXPECT_EQ(summary(r)["reasons"], nlohmann::json::object());
  EXPECT_TRUE(summary(r)["ate_rotation_missing"].is_null());
  r.records[2].reason = r.records[9].reason = "few_matches";
  r.records[3].reason = "dark";
  r.error.ate_rotation_rmse_deg.reset();
  r.error.ate_rotation_missing = "the alignment is not determined";
  nlohmann::json const j = summary(r);
  EXPECT_EQ(j["reasons"], (nlohmann::json{{"few_matches", 2}, {"dark", 1}}));
  EXPECT_EQ(j["ate_rotation_missing"], "the alignment is not determined");
  EXPECT_TRUE(j["ate_rotation_rmse_deg"].is_null());
  std::ostringstream out;
  seq::print_summary(out, r);
  EXPECT_NE(out.str().find("ATE rotation      n/a (the alignment is not determined)"),
            std::string::npos);
  EXPECT_NE(html(r).find("rotation n/a: the alignment is not determined"), std::string::npos);
}

TEST_F(report, json_means_inliers_over_tracked_frames) {
  seq::run_report r = filled(20, false);
  double sum = 0;
  for (auto const& f : r.records) { sum += f.tracked ? f.inliers : 0; }
  EXPECT_NEAR(summary(r)["mean_inliers"], sum / 18, 1e-9);
}

TEST_F(report, json_is_null_without_truth_and_without_frames) {
  nlohmann::json const j = summary(filled(20, false));
  for (char const* key : {"ate_rmse_m", "rpe_rmse_m", "truth_path_m"}) {
    EXPECT_TRUE(j[key].is_null()) << key;
  }
  EXPECT_EQ(j["pairs"], 0);
  EXPECT_DOUBLE_EQ(j["path_m"], 12.5);

  nlohmann::json const none = summary({});
  EXPECT_EQ(none["frames"], 0);
  EXPECT_TRUE(none["fps"].is_null());
  EXPECT_TRUE(none["mean_inliers"].is_null());
  EXPECT_TRUE(none["stages"].is_object());
  EXPECT_TRUE(none["options"].is_object());

  seq::run_report untimed;
  untimed.stages = {"total"};
  EXPECT_TRUE(summary(untimed)["stages"]["total"]["mean_ms"].is_null());
}

TEST_F(report, json_takes_any_bytes_and_numbers) {
  seq::run_report r = filled(5, true);
  r.title = "bytes \xff\xfe \"quoted\"";
  r.error.ate_rmse_m = nan_value;
  r.error.path_m = inf_value;
  nlohmann::json const j = summary(r);
  EXPECT_TRUE(j["ate_rmse_m"].is_null());
  EXPECT_TRUE(j["path_m"].is_number());  // measured on the estimate itself
}

/// Lines of the last path with that style, which is not that of the legend.
long lines_in(std::string const& page, std::string const& style) {
  std::size_t const at = page.rfind("<path class=\"" + style + '"');
  if (at == std::string::npos) { return 0; }
  std::string const drawn = page.substr(at, page.find("/>", at) - at);
  return std::count(drawn.begin(), drawn.end(), 'M');
}

TEST_F(report, maps_that_were_joined_or_loaded) {
  seq::run_report r = filled(20, true);
  auto const said = [&](char const* words) {
    auto const all = seq::warnings_of(r);
    return std::any_of(all.begin(), all.end(),
                       [&](std::string const& w) { return w.find(words) != std::string::npos; });
  };
  r.maps = 2;
  EXPECT_TRUE(said("2 maps were begun"));
  r.loops.emplace();
  EXPECT_FALSE(said("maps were begun")) << "one has been joined with the other";
  r.loops->maps = 2;
  EXPECT_TRUE(said("2 maps were begun"));
  EXPECT_FALSE(summary(r).contains("loaded_map"));
  r.loaded_map = {"room.map", 0};
  EXPECT_TRUE(said("not found in the map room.map"));
  EXPECT_TRUE(summary(r).at("loaded_map").at("found_after").is_null());
  r.loaded_map->found_after = 3;
  EXPECT_FALSE(said("room.map"));
  EXPECT_EQ(summary(r).at("loaded_map").at("found_after"), 3);
}

TEST_F(report, loops_are_counted_and_the_path_without_them_is_drawn) {
  seq::run_report r = filled(20, true);
  EXPECT_EQ(html(r).find("without its loops"), std::string::npos);
  EXPECT_FALSE(summary(r).contains("loops"));
  r.loops.emplace();
  r.loops->closed = 7;
  r.loops->corrections = 2;
  r.loops->online_ate_m = 0.125;
  r.loops->online = r.loops->tracked = r.estimate;
  for (auto& pose : r.loops->tracked) { pose.T_world_camera.translation().x() += 50; }
  auto const json = summary(r).at("loops");
  EXPECT_EQ(json.at("closed"), 7);
  EXPECT_EQ(json.at("corrections"), 2);
  EXPECT_EQ(json.at("online_ate_rmse_m"), 0.125);
  EXPECT_TRUE(json.at("edges").empty());
  EXPECT_EQ(html(r).find("class=\"loop\""), std::string::npos);
  auto loaded = r.estimate[1];
  loaded.time_ns -= 1;  // of another run
  r.loops->edges = {{r.estimate[0], r.estimate[17], 41, false}, {loaded, r.estimate[16], 42, true}};
  auto const edges = summary(r).at("loops").at("edges");
  ASSERT_EQ(edges.size(), 2u);
  EXPECT_EQ(edges[0].at("from_time_ns"), r.estimate[0].time_ns);
  EXPECT_EQ(edges[0].at("to_time_ns"), r.estimate[17].time_ns);
  EXPECT_EQ(edges[1].at("inliers"), 42);
  std::string const page = html(r);
  EXPECT_EQ(lines_in(page, "loop"), 2);
  EXPECT_EQ(lines_in(page, "open-loop"), 1) << "where a loaded keyframe was tracked is not known";
  EXPECT_EQ(markup_fault(page), "");
  EXPECT_NE(page.find("without its loops"), std::string::npos);
  EXPECT_NE(page.find("class=\"tracked\""), std::string::npos);
  std::ostringstream text;
  seq::print_summary(text, r);
  EXPECT_NE(text.str().find("7 closed, in 2 frames"), std::string::npos);
  EXPECT_NE(text.str().find("0.1250 m, of the poses as each frame told them"), std::string::npos);
}

TEST_F(report, warnings_and_stop_are_in_all_outputs) {
  seq::run_report r = filled(20, true);
  r.stopped_at = 20;
  r.stopped_by = "SIGINT";
  r.warnings = {"stopped at frame 20: SIGINT", "a <b> & \"c\""};
  nlohmann::json const j = summary(r);
  EXPECT_EQ(j["warnings"], r.warnings);
  EXPECT_EQ(j["stopped_at"], 20);
  EXPECT_EQ(j["stopped_by"], "SIGINT");
  std::string const text = html(r);
  EXPECT_EQ(markup_fault(text), "");
  EXPECT_NE(text.find("<li>stopped at frame 20: SIGINT</li>"), std::string::npos);
  EXPECT_NE(text.find("a &lt;b&gt; &amp; &quot;c&quot;"), std::string::npos);
  std::ostringstream out;
  seq::print_summary(out, r);
  EXPECT_NE(out.str().find("warning: a <b> & \"c\""), std::string::npos);

  nlohmann::json const whole = summary(filled(20, true));
  EXPECT_TRUE(whole["warnings"].empty());
  EXPECT_TRUE(whole["stopped_at"].is_null());
  EXPECT_EQ(html(filled(20, true)).find("<li>"), std::string::npos);
}

TEST_F(report, evo_commands_fit_the_figures) {
  seq::run_report r = filled(60, true);
  auto const command = [](nlohmann::json const& j, char const* figure) {
    return j["evo"][figure]["command"].get<std::string>();
  };
  nlohmann::json j = summary(r);
  EXPECT_EQ(command(j, "ATE RMSE"), "evo_ape tum groundtruth.txt trajectory.txt --align");
  EXPECT_EQ(command(j, "RPE RMSE over 1 s"),
            "evo_rpe tum groundtruth.txt trajectory.txt --delta 20 --delta_unit f --all_pairs");
  EXPECT_TRUE(j["evo"]["RPE RMSE over 1 s"]["exact"]);
  EXPECT_NE(html(r).find("evo_ape tum"), std::string::npos);

  r.error.rpe_rotation_rmse_deg.reset();  // positions alone
  r.error.rpe_span.reset();               // frames lost: 54 poses in 2.9 s
  j = summary(r);
  EXPECT_NE(command(j, "RPE RMSE over 1 s").find("--pose_relation point_distance"),
            std::string::npos);
  EXPECT_NE(command(j, "RPE RMSE over 1 s").find("--delta 18 "), std::string::npos);
  EXPECT_FALSE(j["evo"]["RPE RMSE over 1 s"]["exact"]);
  EXPECT_NE(html(r).find("about: evo counts poses"), std::string::npos);

  EXPECT_TRUE(summary(filled(60, false))["evo"].empty());
  EXPECT_EQ(html(filled(60, false)).find("evo_"), std::string::npos);
}

TEST_F(report, wall_clock_counts_reading) {
  seq::run_report r = filled(50, false);
  r.wall_s = 2.5;
  EXPECT_DOUBLE_EQ(summary(r)["wall_fps"], 20);
  std::ostringstream out;
  seq::print_summary(out, r);
  EXPECT_NE(out.str().find("2.5 s, 20.0 frames/s"), std::string::npos);
  EXPECT_TRUE(summary(filled(50, false))["wall_fps"].is_null());
}

TEST_F(report, unwritable_paths_throw) {
  std::string const path = file("no/such/folder/file");
  seq::run_report const r = filled(3, false);
  EXPECT_THROW(seq::write_html(path, r), seq::error);
  EXPECT_THROW(seq::write_times_csv(path, r), seq::error);
  try {
    seq::write_summary_json(path, r);
    ADD_FAILURE() << "no exception";
  } catch (seq::error const& e) { EXPECT_NE(std::string(e.what()).find(path), std::string::npos); }
}

TEST_F(report, a_full_disk_throws) {
  if (!std::filesystem::exists("/dev/full")) { GTEST_SKIP() << "no /dev/full"; }
  EXPECT_THROW(seq::write_html("/dev/full", filled(3, false)), seq::error);
}

}  // namespace report_test
