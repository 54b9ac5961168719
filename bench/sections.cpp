// SPDX-License-Identifier: Apache-2.0
#include "bench/sections.hpp"

#include <algorithm>
#include <atomic>
#include <cstdio>
#include <exception>
#include <functional>
#include <mutex>
#include <thread>

#include "bench/clock.hpp"
#include "bench/host_stages.hpp"
#include "bench/plan.hpp"
#include "examples/sequence/report.hpp"

namespace bench {

namespace {

using json = nlohmann::json;

std::vector<int> const& or_default(std::vector<int> const& given, std::vector<int> const& usual) {
  return given.empty() ? usual : given;
}

int host_threads() { return static_cast<int>(std::max(1u, std::thread::hardware_concurrency())); }

json counts_json(frame_counts const& c) {
  return {{"keypoints", c.keypoints},
          {"stereo_matches", c.stereo_matches},
          {"last_matches", c.last_matches},
          {"last_inliers", c.last_inliers},
          {"local_matches", c.local_matches},
          {"inliers", c.inliers},
          {"position_error_m", c.position_error}};
}

void print_counts(frame_counts const& c) {
  std::printf(
      "  a frame has %.0f left keypoints, %.0f with depth; last frame: %.0f matches, %.0f inliers; "
      "local map of %d points: %.0f matches, %.0f inliers; camera off by %.1f mm\n",
      c.keypoints, c.stereo_matches, c.last_matches, c.last_inliers, c.map_points, c.local_matches,
      c.inliers, 1000 * c.position_error);
}

void print_head(char const* title) {
  std::printf("\n%s\n%-48s %-5s %6s %6s %9s %9s %9s %9s %9s\n", title, "what", "on", "batch",
              "calls", "mean us", "std us", "p50 us", "p99 us", "frames/s");
}

/// Prints a row of times and returns it as JSON, in the format of the oldest results.
json row_of(std::string const& name, backend_type b, int batch, std::vector<double> const& us) {
  auto const s = seq::summarise(us);
  double const rate = s.p50 > 0 ? batch * 1e6 / s.p50 : 0;
  std::printf("%-48s %-5s %6d %6zu %9.1f %9.1f %9.1f %9.1f %9.0f\n", name.c_str(), name_of(b),
              batch, us.size(), s.mean, s.std, s.p50, s.p99, rate);
  std::fflush(stdout);
  return {{"name", name},      {"backend", name_of(b)}, {"batch", batch},  {"calls", us.size()},
          {"mean_us", s.mean}, {"std_us", s.std},       {"p50_us", s.p50}, {"p99_us", s.p99},
          {"max_us", s.max},   {"frames_per_s", rate}};
}

void add_counts(json& row, frame_counts const& c) {
  row["inliers"] = static_cast<int>(c.inliers + 0.5);
  row["map_points"] = c.map_points;
  row["counts"] = counts_json(c);
}

/// The map updates before each frame, as part of its time.
struct map_traffic {
  int whole_points = 0;  ///< points sent with all fields
  int positions = 0;     ///< points of which only the position is sent
};

/// Microseconds per frame, from all input in pinned memory to the result in host memory.
std::vector<double> time_frames(frame_runner& r, call_type how, int warm_up, int frames,
                                map_traffic const& sent = {}) {
  std::vector<double> us;
  for (int i = 0; i < warm_up + frames; ++i) {
    r.prepare(i);
    double const start = now_us();
    if (sent.whole_points > 0) { r.update_map(sent.whole_points); }
    if (sent.positions > 0) { r.update_positions(sent.positions); }
    r.launch(how);
    r.wait();
    if (i >= warm_up) { us.push_back(now_us() - start); }
  }
  return us;
}

char const* array_of(rig_type rig) { return rig == rig_type::rectified ? "rows" : "fisheye"; }

}  // namespace

scene const& scenes::get(rig_type rig) {
  auto& s = made_[rig];
  if (!s) {
    int const features = rig == rig_type::fisheye ? how_.fisheye_features : how_.features;
    bool const recorded = rig == rig_type::rectified && !how_.sequence.empty();
    s = std::make_unique<scene>(
        recorded ? read_scene(how_.sequence, how_.images, features, how_.local_points)
                 : make_scene(rig, 0, 0, how_.images, features, how_.local_points));
  }
  return *s;
}

// ---- camera models ----------------------------------------------------------------------------

void cameras_section(context const& c, backend_type b) {
  bool const cuda = b == backend_type::cuda;
  int const points = c.how.points > 0 ? c.how.points : (cuda ? 1 << 20 : 1 << 16);
  constexpr int sets = 4;
  std::printf("\nCamera models: %d different points a call, %d sets in turn\n", points, sets);
  std::printf("%-18s %-13s %-17s %-5s %8s %12s %8s\n", "model", "scalar", "function", "on",
              "threads", "ns a point", "valid");
  std::vector<int> threads{0};
  if (!cuda) { threads = {1, 0}; }
  for (int t : threads) {
    auto const runner = make_camera_runner(b, t, points, sets);
    auto const& cases = runner->cases();
    for (std::size_t k = 0; k < cases.size(); ++k) {
      runner->select(static_cast<int>(k));
      int const launches = cuda ? 20 : sets;
      runner->run(0, launches);
      std::vector<double> ns;
      for (int i = 0; i < 9; ++i) {
        ns.push_back(1000.0 * runner->run(i, launches) / (static_cast<double>(points) * launches));
      }
      double const p50 = seq::summarise(ns).p50;
      double const valid = runner->valid_share();
      int const used = cuda ? 0 : (t == 0 ? host_threads() : t);
      std::printf("%-18s %-13s %-17s %-5s %8d %12.4f %7.1f%%\n", cases[k].model.c_str(),
                  cases[k].scalar.c_str(), cases[k].op.c_str(), name_of(b), used, p50, 100 * valid);
      std::fflush(stdout);
      (*c.out)["cameras"].push_back({{"model", cases[k].model},
                                     {"scalar", cases[k].scalar},
                                     {"function", cases[k].op},
                                     {"backend", name_of(b)},
                                     {"threads", used},
                                     {"points", points},
                                     {"ns_per_point", p50},
                                     {"valid", valid}});
    }
  }
}

// ---- one pair ---------------------------------------------------------------------------------

void frame_section(context const& c, backend_type b, rig_type rig) {
  scene const& s = c.all_scenes->get(rig);
  print_head((std::string("One pair, ") + name_of(rig) + ", " + std::to_string(s.width) + "x" +
              std::to_string(s.height) + ", " + std::to_string(s.features) + " features")
                 .c_str());
  for (bool optimize : {false, true}) {
    frame_options o;
    o.backend = b;
    o.optimize_last = o.optimize_local = optimize;
    auto const runner = make_frame_runner(s, o);
    frame_counts const counts = runner->counts();
    std::string const suffix = optimize ? ", with pose optimisation" : "";
    for (call_type how : {call_type::whole, call_type::two_halves}) {
      std::string const name = how == call_type::whole ? "frame" : "frame in two halves";
      json row = row_of(name + suffix, b, 1,
                        time_frames(*runner, how, c.how.warm_up_on(b), c.how.frames_on(b)));
      add_counts(row, counts);
      (*c.out)[array_of(rig)].push_back(row);
    }
    runner->borrow_images(false);
    json row =
        row_of("frame, images copied by the host" + suffix, b, 1,
               time_frames(*runner, call_type::whole, c.how.warm_up_on(b), c.how.frames_on(b)));
    add_counts(row, counts);
    (*c.out)[array_of(rig)].push_back(row);
    print_counts(counts);
  }
}

void stages_section(context const& c, backend_type b, rig_type rig) {
  frame_options o;
  o.backend = b;
  o.measure_stages = true;
  auto const runner = make_frame_runner(c.all_scenes->get(rig), o);
  int const frames =
      b == backend_type::cuda ? std::max(1, c.how.frames_on(b) / 4) : c.how.frames_on(b);
  print_head((std::string("What each stage adds to a frame, ") + name_of(rig)).c_str());
  std::vector<std::string> names;
  std::vector<std::vector<double>> us;
  std::vector<double> sums;
  for (int i = 0; i < c.how.warm_up_on(b) + frames; ++i) {
    auto const times = runner->stage_times(i);
    if (i < c.how.warm_up_on(b)) { continue; }
    double sum = 0;
    us.resize(times.size());
    names.resize(times.size());
    for (std::size_t k = 0; k < times.size(); ++k) {
      names[k] = times[k].name;
      us[k].push_back(times[k].us);
      sum += times[k].us;
    }
    sums.push_back(sum);
  }
  for (std::size_t k = 0; k < names.size(); ++k) {
    json row = row_of("stage: " + names[k], b, 1, us[k]);
    row["map_points"] = runner->map_points();
    row["rig"] = name_of(rig);
    (*c.out)["stages"].push_back(row);
  }
  static_cast<void>(row_of("all stages", b, 1, sums));
}

// ---- many pairs -------------------------------------------------------------------------------

void batch_section(context const& c, backend_type b) {
  bool const cuda = b == backend_type::cuda;
  scene const& s = c.all_scenes->get(rig_type::rectified);
  std::vector<int> const usual =
      cuda ? std::vector<int>{1, 2, 4, 8, 16, 32, 64, 128, 256} : std::vector<int>{1, 2, 4, 8};
  print_head("Batches of rectified pairs in one call");
  for (int batch : or_default(c.how.batches, usual)) {
    frame_options o;
    o.backend = b;
    o.batch = batch;
    try {
      auto const runner = make_frame_runner(s, o);
      int const one = cuda ? std::max(1, c.how.frames_on(b) / 4) : c.how.frames_on(b) / 4;
      int const calls = calls_of_batch(std::max(1, one), batch);
      json row = row_of("batch of frames, with pose optimisation", b, batch,
                        time_frames(*runner, call_type::whole,
                                    std::min(c.how.warm_up_on(b), std::max(2, calls / 4)), calls));
      add_counts(row, runner->counts());
      (*c.out)["rows"].push_back(row);
    } catch (no_memory const& e) {
      std::printf("batch of %d left out: %s\n", batch, e.what());
      (*c.out)["left_out"].push_back("batch of " + std::to_string(batch) + ": " + e.what());
    }
  }
}

namespace {

/// All trackers start a frame at the same time, and the next one when all are done. The images are
/// already in pinned memory.
void all_at_once(std::vector<std::unique_ptr<frame_runner>>& trackers, int rounds, int warm_up,
                 std::vector<double>& latency, std::vector<double>& round_us) {
  auto const n = trackers.size();
  std::vector<double> start(n);
  for (int i = 0; i < warm_up + rounds; ++i) {
    for (std::size_t k = 0; k < n; ++k) { trackers[k]->prepare(i + static_cast<int>(k)); }
    double const begin = now_us();
    std::vector<std::size_t> open;
    for (std::size_t k = 0; k < n; ++k) {
      start[k] = now_us();
      trackers[k]->launch(call_type::whole);
      open.push_back(k);
    }
    while (!open.empty()) {
      for (std::size_t at = 0; at < open.size();) {
        if (!trackers[open[at]]->done()) {
          ++at;
          continue;
        }
        if (i >= warm_up) { latency.push_back(now_us() - start[open[at]]); }
        open.erase(open.begin() + static_cast<std::ptrdiff_t>(at));
      }
    }
    if (i >= warm_up) { round_us.push_back(now_us() - begin); }
  }
}

/// Each thread drives its trackers round robin until all together have finished `target` frames.
/// When a tracker is done, the thread copies the next images to staging memory and launches.
std::vector<finished_frame> without_pause(std::vector<std::unique_ptr<frame_runner>>& trackers,
                                          int threads, int target) {
  std::mutex guard;
  std::exception_ptr failure;
  std::atomic<int> count{0};
  std::vector<finished_frame> all;
  auto const drive = [&](int part) {
    try {
      auto const share = share_of(static_cast<int>(trackers.size()), threads, part);
      int const first = share.first;
      auto const n = static_cast<std::size_t>(share.second - first);
      std::vector<double> start(n, 0.0);
      std::vector<finished_frame> mine;
      std::vector<int> frame(n, 0);
      auto const at = [&](std::size_t k) -> frame_runner& {
        return *trackers[static_cast<std::size_t>(first) + k];
      };
      auto const go = [&](std::size_t k) {
        at(k).prepare(frame[k]++ + first + static_cast<int>(k));
        start[k] = now_us();
        at(k).launch(call_type::whole);
      };
      for (std::size_t k = 0; k < n; ++k) { go(k); }
      while (count < target) {
        for (std::size_t k = 0; k < n; ++k) {
          if (!at(k).done()) { continue; }
          double const now = now_us();
          mine.push_back({now, now - start[k]});
          ++count;
          go(k);
        }
      }
      for (std::size_t k = 0; k < n; ++k) { at(k).wait(); }
      std::lock_guard<std::mutex> const lock(guard);
      all.insert(all.end(), mine.begin(), mine.end());
    } catch (...) {
      std::lock_guard<std::mutex> const lock(guard);
      if (!failure) { failure = std::current_exception(); }
      count = target;
    }
  };
  std::vector<std::thread> pool;
  for (int t = 1; t < threads; ++t) { pool.emplace_back(drive, t); }
  drive(0);
  for (auto& t : pool) { t.join(); }
  if (failure) { std::rethrow_exception(failure); }
  return all;
}

}  // namespace

void streams_section(context const& c, backend_type b) {
  bool const cuda = b == backend_type::cuda;
  scene const& s = c.all_scenes->get(rig_type::rectified);
  std::vector<int> const usual =
      cuda ? std::vector<int>{1, 2, 4, 8, 16, 32, 64} : std::vector<int>{1, 2, 4};
  std::printf(
      "\nIndependent trackers, each with %s, with pose optimisation\n%-48s %-5s %8s %8s %8s "
      "%9s %9s %9s\n",
      cuda ? "a stream of its own" : "one thread", "what", "on", "trackers", "threads", "frames",
      "p50 us", "p99 us", "frames/s");
  auto const report = [&](std::string const& name, int n, int threads,
                          std::vector<double> const& latency, double rate) {
    auto const t = seq::summarise(latency);
    std::printf("%-48s %-5s %8d %8d %8zu %9.1f %9.1f %9.0f\n", name.c_str(), name_of(b), n, threads,
                latency.size(), t.p50, t.p99, rate);
    std::fflush(stdout);
    (*c.out)["streams"].push_back({{"name", name},
                                   {"backend", name_of(b)},
                                   {"streams", n},
                                   {"threads", threads},
                                   {"frames", latency.size()},
                                   {"p50_us", t.p50},
                                   {"p99_us", t.p99},
                                   {"frames_per_s", rate}});
  };
  std::vector<std::unique_ptr<frame_runner>> trackers;
  for (int n : or_default(c.how.streams, usual)) {
    try {
      while (static_cast<int>(trackers.size()) < n) {
        frame_options o;
        o.backend = b;
        o.host_threads = 1;
        trackers.push_back(make_frame_runner(s, o));
      }
    } catch (no_memory const& e) {
      std::printf("%d trackers left out: %s\n", n, e.what());
      (*c.out)["left_out"].push_back(std::to_string(n) + " trackers: " + e.what());
      break;
    }
    trackers.resize(static_cast<std::size_t>(n));
    auto const borrow = [&](bool yes) {
      for (auto& t : trackers) { t->borrow_images(yes); }
    };
    if (cuda) {
      borrow(true);
      std::vector<double> latency, rounds;
      int const count = calls_of_batch(std::max(1, c.how.frames_on(b) / 4), n);
      all_at_once(trackers, count, std::max(2, count / 4), latency, rounds);
      double sum = 0;
      for (double us : rounds) { sum += us; }
      report("images at the same time, staged before", n, 1, latency,
             sum > 0 ? 1e6 * static_cast<double>(latency.size()) / sum : 0);
    }
    std::vector<int> thread_counts{1};
    if (std::min(n, host_threads()) > 1) { thread_counts.push_back(std::min(n, host_threads())); }
    borrow(false);
    for (int threads : thread_counts) {
      int const target = std::max(2 * c.how.frames_on(b), 12 * n);
      auto frames = without_pause(trackers, threads, target);
      std::vector<double> latency;
      double const rate = steady_rate(frames, latency);
      report("without pause, threads copy the images", n, threads, latency, rate);
    }
  }
}

// ---- contents of a frame ---------------------------------------------------------------------

void graph_section(context const& c, backend_type b) {
  std::printf("\nA recorded frame, with pose optimisation\n");
  if (b == backend_type::host) {
    std::printf("(nothing is recorded on the host)\n");
    return;
  }
  std::printf("%-10s %6s %8s %7s %6s %7s %10s %12s %12s %14s\n", "rig", "batch", "kernels",
              "copies", "fills", "others", "bytes up", "bytes down", "within", "result bytes");
  for (rig_type rig : {rig_type::rectified, rig_type::fisheye}) {
    for (int batch : {1, 8}) {
      frame_options o;
      o.backend = b;
      o.batch = batch;
      o.use_graphs = false;
      auto const g = make_frame_runner(c.all_scenes->get(rig), o)->graph();
      std::printf("%-10s %6d %8d %7d %6d %7d %10zu %12zu %12zu %14zu\n", name_of(rig), batch,
                  g.kernels, g.copies, g.fills, g.others, g.bytes_up, g.bytes_down, g.bytes_within,
                  g.result_bytes);
      (*c.out)["graph"].push_back({{"rig", name_of(rig)},
                                   {"batch", batch},
                                   {"kernels", g.kernels},
                                   {"copies", g.copies},
                                   {"fills", g.fills},
                                   {"others", g.others},
                                   {"bytes_up", g.bytes_up},
                                   {"bytes_down", g.bytes_down},
                                   {"bytes_within", g.bytes_within},
                                   {"result_bytes", g.result_bytes}});
    }
  }
}

void kernels_section(context const& c, backend_type b) {
  std::printf("\nKernels of a recorded frame\n");
  if (b == backend_type::host) {
    std::printf("(needs a device; without one see bench/kernel_resources.py)\n");
    return;
  }
  std::printf("%-64s %-10s %5s %7s %7s %5s %7s %7s %8s\n", "kernel", "rig", "calls", "threads",
              "blocks", "regs", "shared", "local", "thr./SM");
  for (rig_type rig : {rig_type::rectified, rig_type::fisheye}) {
    frame_options o;
    o.backend = b;
    o.use_graphs = false;
    for (auto const& k : make_frame_runner(c.all_scenes->get(rig), o)->kernels()) {
      std::printf("%-64s %-10s %5d %7d %7d %5d %7zu %7zu %4d/%d\n", k.name.c_str(), name_of(rig),
                  k.launches, k.threads, k.blocks, k.registers, k.shared, k.local, k.threads_per_sm,
                  k.most_threads_sm);
      (*c.out)["kernels"].push_back({{"name", k.name},
                                     {"rig", name_of(rig)},
                                     {"launches", k.launches},
                                     {"threads", k.threads},
                                     {"blocks", k.blocks},
                                     {"registers", k.registers},
                                     {"shared_bytes", k.shared},
                                     {"local_bytes", k.local},
                                     {"threads_per_sm", k.threads_per_sm},
                                     {"most_threads_per_sm", k.most_threads_sm}});
    }
  }
}

// ---- one choice at a time ---------------------------------------------------------------------

void ablation_section(context const& c, backend_type b, bool with_host) {
  scene const& s = c.all_scenes->get(rig_type::rectified);
  int const frames = std::max(1, c.how.frames_on(b) / 2);
  print_head("One choice at a time, rectified; the first row is the reference");
  double reference = 0;
  auto const add = [&](std::string const& name, backend_type on, std::vector<double> const& us) {
    json row = row_of(name, on, 1, us);
    if (reference <= 0) { reference = row["p50_us"].get<double>(); }
    row["times_reference"] = row["p50_us"].get<double>() / reference;
    (*c.out)["ablation"].push_back(row);
  };
  auto const options = [&](bool last, bool local) {
    frame_options o;
    o.backend = b;
    o.optimize_last = last;
    o.optimize_local = local;
    return o;
  };
  int const warm_up = c.how.warm_up_on(b);
  {
    auto const r = make_frame_runner(s, options(true, true));
    add("as it is", b, time_frames(*r, call_type::whole, warm_up, frames));
    add("in two halves, host in between", b,
        time_frames(*r, call_type::two_halves, warm_up, frames));
    int const all = r->map_points();
    int const some = std::min(100, all);
    add("map: " + std::to_string(some) + " points sent each frame", b,
        time_frames(*r, call_type::whole, warm_up, frames, {some, 0}));
    add("map: all local points sent each frame", b,
        time_frames(*r, call_type::whole, warm_up, frames, {all, 0}));
    add("map: positions of all local points sent each frame", b,
        time_frames(*r, call_type::whole, warm_up, frames, {0, all}));
  }
  if (b == backend_type::cuda) {
    frame_options o = options(true, true);
    o.use_graphs = false;
    add("launch after launch, no graph", b,
        time_frames(*make_frame_runner(s, o), call_type::whole, warm_up, frames));
  }
  {
    frame_options o = options(true, true);
    o.measure_stages = true;
    add("with times of stages", b,
        time_frames(*make_frame_runner(s, o), call_type::whole, warm_up, frames));
  }
  add("no pose optimisation after the last frame's search", b,
      time_frames(*make_frame_runner(s, options(false, true)), call_type::whole, warm_up, frames));
  add("no pose optimisation after the local map's search", b,
      time_frames(*make_frame_runner(s, options(true, false)), call_type::whole, warm_up, frames));
  add("no pose optimisation", b,
      time_frames(*make_frame_runner(s, options(false, false)), call_type::whole, warm_up, frames));
  for (int threads : {0, 1}) {
    bool const on_host = b == backend_type::host;
    if (!on_host && !with_host) { continue; }
    if (on_host && threads == 0) { continue; }  // the reference
    frame_options o;
    o.host_threads = threads;
    auto const r = make_frame_runner(s, o);
    add("host, " + (threads == 0 ? std::to_string(host_threads()) + " threads" : "one thread"),
        backend_type::host,
        time_frames(*r, call_type::whole, c.how.warm_up_on(backend_type::host),
                    std::max(8, c.how.frames_on(b) / 50)));
  }
}

// ---- one host thread next to OpenCV -----------------------------------------------------------

namespace {

json times_json(seq::statistics const& s) {
  return {{"mean_us", s.mean},
          {"std_us", s.std},
          {"p50_us", s.p50},
          {"p99_us", s.p99},
          {"max_us", s.max}};
}

}  // namespace

void host_stages_section(context const& c) {
  scene const& s = c.all_scenes->get(rig_type::rectified);
  auto const stages = make_host_stages(s);
  auto const pairs = static_cast<int>(s.frames.size());
  int const warm_up = c.how.warm_up > 0 ? c.how.warm_up : pairs;
  int const calls = c.how.frames > 0 ? c.how.frames : 20 * pairs;
  std::string const opencv = opencv_description();
  std::printf(
      "\nStages on one host thread, its processor time, both images of a %dx%d pair, %d features, "
      "%d calls; ft for %s; "
      "%s\n",
      s.width, s.height, s.features, calls, instruction_set().c_str(),
      opencv.empty() ? "built without OpenCV" : opencv.c_str());
  std::printf("%-32s %9s %9s %9s %9s %7s  %s\n", "stage", "ft p50 us", "p99 us", "OpenCV p50",
              "p99 us", "ratio", "OpenCV's call: what differs");
  for (auto const& stage : stages->all()) {
    std::vector<double> ours, theirs;
    for (int i = 0; i < warm_up + calls; ++i) {
      stages->prepare(i % pairs);
      // In turn, so that each finds the caches as the other leaves them.
      auto const time = [&](std::function<void()> const& call, std::vector<double>& us) {
        double const start = thread_us();
        call();
        if (i >= warm_up) { us.push_back(thread_us() - start); }
      };
      bool const first = i / pairs % 2 == 0;
      if (first) { time(stage.ours, ours); }
      if (stage.theirs) { time(stage.theirs, theirs); }
      if (!first) { time(stage.ours, ours); }
    }
    auto const a = seq::summarise(ours);
    json row{{"name", stage.name},
             {"calls", calls},
             {"instruction_set", instruction_set()},
             {"ft", times_json(a)}};
    std::printf("%-32s %9.1f %9.1f", stage.name.c_str(), a.p50, a.p99);
    if (stage.theirs) {
      auto const b = seq::summarise(theirs);
      row["opencv"] = times_json(b);
      row["opencv_version"] = opencv;
      row["counterpart"] = stage.counterpart;
      row["difference"] = stage.difference;
      row["times_as_fast"] = b.p50 / a.p50;
      std::printf(" %10.1f %9.1f %7.2f  %s: %s", b.p50, b.p99, b.p50 / a.p50,
                  stage.counterpart.c_str(), stage.difference.c_str());
    }
    std::printf("\n");
    std::fflush(stdout);
    (*c.out)["host_stages"].push_back(row);
  }
}

}  // namespace bench
