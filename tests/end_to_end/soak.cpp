// SPDX-License-Identifier: Apache-2.0
// A tracker for many frames: in order, dropped, duplicated, shuffled, black, white and noise, with
// calls that are refused and trackers made anew in between. Frames that were seen before must give
// the same bits, and memory must stay as it was once everything has been touched.
//
//     soak [--frames N] [--curve FILE.csv] [--summary FILE.json]
//
// On a GPU where nvcc compiles it (-x cu), else on the host's threads. Nothing but ft is needed.
#include <algorithm>
#include <chrono>
#include <cmath>
#include <cstdint>
#include <cstdio>
#include <cstdlib>
#include <cstring>
#include <exception>
#include <fstream>
#include <memory>
#include <random>
#include <stdexcept>
#include <string>
#include <vector>

#include "ft/pipelines/frame_tracker.hpp"
#include "tests/end_to_end/soak_scene.hpp"
#include "tests/support/process_memory.hpp"

namespace soak {

using namespace soak_scene;

// ---- what is seen -----------------------------------------------------------------------------

struct frame {
  image left, right;
  ft::pose T_cw;
};

/// Frames that can come again: a walk to and fro, then black, white and three of noise.
struct gallery {
  static constexpr int walk = 20;
  static constexpr int black = walk, white = walk + 1, noises = walk + 2;
  static constexpr int size = walk + 5;
  std::vector<frame> frames;

  gallery() {
    for (int i = 0; i < walk; ++i) {
      double const x = 0.4 * std::sin(i * 6.283185307 / walk);
      double const z = 0.2 * std::cos(i * 6.283185307 / walk);
      frame f{render(x, z), render(x + 0.2, z), ft::pose::identity()};
      f.T_cw.t = {static_cast<float>(-x), 0, static_cast<float>(-z)};
      frames.push_back(f);
    }
    for (unsigned const grey : {0u, 255u}) {
      image const flat(pixels, static_cast<std::uint8_t>(grey));
      frames.push_back({flat, flat, ft::pose::identity()});
    }
    for (unsigned i = 0; i < 3; ++i) {
      frames.push_back({noise(2 * i), noise(2 * i + 1), ft::pose::identity()});
    }
  }
};

// ---- what is remembered -----------------------------------------------------------------------

/// Digests of what was seen before, 0 = not seen yet.
class memory_of_results {
public:
  explicit memory_of_results(std::size_t keys) : seen_(keys, 0) {}

  /// @throws std::runtime_error where the same key had another digest
  void check(std::size_t key, std::uint64_t digest, char const* what) {
    if (seen_[key] == 0) {
      seen_[key] = digest;
      ++first_;
      return;
    }
    ++again_;
    if (seen_[key] != digest) {
      throw std::runtime_error(std::string("another result than before: ") + what + ", key " +
                               std::to_string(key));
    }
  }
  long first() const { return first_; }
  long again() const { return again_; }

private:
  std::vector<std::uint64_t> seen_;
  long first_ = 0;
  long again_ = 0;
};

// ---- memory of the process --------------------------------------------------------------------

using test::usage;

struct sample {
  int frame;
  usage memory;
};

// ---- the tracker ------------------------------------------------------------------------------

/// A tracker, its map, and what each frame of the gallery holds of it.
template <typename Exec>
class subject {
public:
  subject(Exec const& exec, gallery const& frames)
      : exec_(exec), frames_(frames), descriptors_(descriptor_room) {
    make();
    build_map();
    for (int i = 0; i < gallery::size; ++i) { find_holders(i); }
  }

  /// Destroys the tracker and makes it anew, with the same map.
  void make() {
    tracker_.reset();
    tracker_ = std::make_unique<ft::frame_tracker<Exec>>(exec_, rig(), params());
    nothing_.assign(static_cast<std::size_t>(tracker_->capacity()), -1);
    previous_ = none;
    if (!points_.empty()) { write_map(); }
  }
  void write_map() {
    tracker_->update_map(exec_, 0, points_.data(), static_cast<int>(points_.size()));
    exec_.wait();
  }

  /// Images that never come again. The frame after it has no key.
  void see_once(unsigned seed) {
    image const left = noise(seed);
    image const right = noise(seed + 1);
    set_images(left, right);
    tracker_->extract(exec_);
    exec_.wait();
    previous_ = unknown;
  }

  /// @param in_halves track_motion() and track_local() in place of track(): the same results
  void see(int i, bool in_halves, memory_of_results& features, memory_of_results& tracked) {
    auto const& f = frames_.frames[static_cast<std::size_t>(i)];
    set_images(f.left, f.right);
    bool const has_last = previous_ != none && previous_ != unknown;
    int const last = has_last ? previous_ : 0;
    ft::pose predicted = f.T_cw;
    predicted.t.x += 0.01f;
    int const capacity = tracker_->capacity();
    ft::slot_list const nothing{nothing_.data(), capacity};
    tracker_->set_last(exec_, 0, frames_.frames[static_cast<std::size_t>(last)].T_cw,
                       has_last ? ft::slot_list{holders(last), capacity} : nothing);
    if (in_halves) {
      tracker_->track_motion(exec_, predicted);
      exec_.wait();
      tracker_->track_local(exec_, local_slots_);
    } else {
      tracker_->track(exec_, {predicted, local_slots_});
    }
    exec_.wait();
    features.check(static_cast<std::size_t>(i), digest_features(), "features and stereo");
    // Without a last frame no keypoint of it holds a point, whatever it was.
    std::size_t const from = has_last ? static_cast<std::size_t>(previous_) : gallery::size;
    tracked.check(from * gallery::size + static_cast<std::size_t>(i), digest_tracking(),
                  "searches and pose");
    inliers_ = tracker_->result().inliers[0];
    previous_ = i;
  }
  int inliers() const { return inliers_; }
  int points() const { return static_cast<int>(points_.size()); }

  /// Calls that are refused; what follows must not notice.
  void misuse() {
    image const small(pixels / 2);
    ft::point_update outside{};
    outside.slot = params().map_slots;
    int const refused =
        refuses([&] {
          tracker_->set_image(0, 0, {small.data(), width, height / 2, width});
        }) +
        refuses([&] {
          tracker_->set_image(0, 0, {nullptr, width, height, width});
        }) +
        refuses([&] { tracker_->update_map(exec_, 0, &outside, 1); }) + refuses([&] {
          std::vector<int> const many(static_cast<std::size_t>(params().local_points) + 1);
          tracker_->track(exec_, {ft::pose::identity(), many});
        });
    if (refused != 4) { throw std::runtime_error("a call that cannot be was accepted"); }
  }

private:
  static constexpr int none = -1, unknown = -2;
  static constexpr int descriptor_room = 4096;

  static ft::tracker_params params() {
    ft::tracker_params p;
    p.orb.width = width;
    p.orb.height = height;
    p.orb.features = 400;
    p.orb.levels = 6;
    p.map_slots = 1024;
    p.local_points = 1024;
    p.updates = 1024;
    return p;
  }

  template <typename Call>
  static int refuses(Call const& call) {
    try {
      call();
    } catch (ft::bad_argument const&) { return 1; }
    return 0;
  }

  void set_images(image const& left, image const& right) {
    tracker_->set_image(0, 0, {left.data(), width, height, width});
    tracker_->set_image(0, 1, {right.data(), width, height, width});
  }
  int* holders(int i) {
    auto const room = static_cast<std::size_t>(tracker_->capacity());
    holders_.resize(room * gallery::size);
    return holders_.data() + static_cast<std::size_t>(i) * room;
  }

  /// A map point of every keypoint of frame 0 that has a depth.
  void build_map() {
    auto const& f = frames_.frames[0];
    set_images(f.left, f.right);
    tracker_->extract(exec_);
    exec_.wait();
    auto const& r = tracker_->result();
    tracker_->download_descriptors(exec_, 0, descriptors_.data(), r.keypoints[0]);
    exec_.wait();
    auto const& scale = tracker_->geometry().scale;
    for (int i = 0; i < r.keypoints[0]; ++i) {
      if (!(r.depth[i] > 0)) { continue; }
      ft::vec3<float> const p = r.point[i];
      float const distance = std::sqrt(ft::dot(p, p));
      float const farthest = distance * scale[r.octave[i]];
      local_slots_.push_back(points());
      points_.push_back({points(),
                         1,
                         f.T_cw.inverse() * p,
                         {p.x / distance, p.y / distance, p.z / distance},
                         farthest / scale[params().orb.levels - 1],
                         farthest,
                         descriptors_[static_cast<std::size_t>(i)]});
    }
    if (points() < 100) { throw std::runtime_error("the first frame has too few depths"); }
    write_map();
  }

  /// What frame i holds where the pose is known and there is no last frame.
  void find_holders(int i) {
    auto const& f = frames_.frames[static_cast<std::size_t>(i)];
    set_images(f.left, f.right);
    tracker_->extract(exec_);
    exec_.wait();
    tracker_->relocalize(exec_, {f.T_cw, local_slots_});
    exec_.wait();
    std::copy_n(tracker_->result().holder, tracker_->capacity(), holders(i));
    previous_ = i;
  }

  std::uint64_t digest_features() {
    auto const& r = tracker_->result();
    auto const n = static_cast<std::size_t>(r.keypoints[0]);
    tracker_->download_descriptors(exec_, 0, descriptors_.data(), r.keypoints[0]);
    exec_.wait();
    digest d;
    d.add(r.keypoints, 1);
    d.add(r.x, n);
    d.add(r.y, n);
    d.add(r.octave, n);
    d.add(r.depth, n);
    d.add(descriptors_.data(), n);
    return d.value();
  }
  std::uint64_t digest_tracking() const {
    auto const& r = tracker_->result();
    digest d;
    d.add(r.T_cw, 1);
    d.add(r.matches, 1);
    d.add(r.inliers, 1);
    d.add(r.holder, static_cast<std::size_t>(r.capacity));
    d.add(r.in_view, static_cast<std::size_t>(points()));
    return d.value();
  }

  Exec exec_;
  gallery const& frames_;
  std::unique_ptr<ft::frame_tracker<Exec>> tracker_;
  std::vector<ft::point_update> points_;
  std::vector<int> local_slots_;  ///< all points
  std::vector<int> nothing_;      ///< held by no keypoint
  std::vector<int> holders_;
  std::vector<ft::descriptor> descriptors_;
  int previous_ = none;
  int inliers_ = 0;
};

// ---- the run ----------------------------------------------------------------------------------

enum kind { next, dropped, duplicate, shuffled, black, white, repeated_noise, new_noise, kinds };
constexpr char const* kind_names[kinds] = {"next",  "dropped", "duplicate",      "shuffled",
                                           "black", "white",   "repeated noise", "new noise"};

struct options {
  int frames = 2000;
  std::string curve, summary;
};

/// How far memory may be above what it was after the warm-up. A leak of 100 bytes a frame shows in
/// 100,000 frames in each of them, one of 1 kB on the heap in 2000.
constexpr long long resident_slack = 8 << 20;
constexpr long long heap_slack = 256 << 10;
constexpr long long device_slack = 2 << 20;

struct outcome {
  std::vector<sample> curve;
  int counts[kinds] = {};
  long first = 0, again = 0;
  int points = 0;
  int walked = 0, followed = 0;  ///< frames of the walk, and those of 30 or more inliers
  double seconds = 0;
  usage growth;

  bool good() const { return flat() && followed == walked; }
  bool flat() const {
    return growth.resident <= resident_slack && growth.heap <= heap_slack &&
           growth.device <= device_slack;
  }
};

kind choose(std::mt19937& random) {
  auto const r = random() % 100;
  return r < 40   ? next
         : r < 55 ? dropped
         : r < 65 ? duplicate
         : r < 80 ? shuffled
         : r < 85 ? black
         : r < 90 ? white
         : r < 95 ? repeated_noise
                  : new_noise;
}

template <typename Exec>
outcome run(Exec const& exec, options const& o) {
  auto const begin = std::chrono::steady_clock::now();
  gallery const frames;
  subject<Exec> tracker(exec, frames);
  memory_of_results features(gallery::size);
  memory_of_results tracked(static_cast<std::size_t>(gallery::size + 1) * gallery::size);
  outcome result;
  result.points = tracker.points();
  int const warm_up = std::max(1, std::min(o.frames / 4, 5000));
  int const every = std::max(1, o.frames / 200);
  result.curve.reserve(static_cast<std::size_t>(o.frames / every) + 3);
  std::mt19937 random(7);
  usage warm;
  int place = 0;
  for (int n = 0; n < o.frames; ++n) {
    kind const k = choose(random);
    auto const pick = [&](int below) {
      return static_cast<int>(random() % static_cast<unsigned>(below));
    };
    ++result.counts[k];
    int shown = place;
    switch (k) {
      case next:
        shown = place = (place + 1) % gallery::walk;
        break;
      case dropped:
        shown = place = (place + 2 + pick(4)) % gallery::walk;
        break;
      case duplicate:
        break;
      case shuffled:
        shown = place = pick(gallery::walk);
        break;
      case black:
        shown = gallery::black;
        break;
      case white:
        shown = gallery::white;
        break;
      case repeated_noise:
        shown = gallery::noises + pick(3);
        break;
      default:
        shown = -1;
    }
    if (n % 100 == 50) { tracker.misuse(); }
    if (n % 250 == 125) { tracker.write_map(); }
    if (n % 500 == 499) { tracker.make(); }
    if (shown < 0) {
      tracker.see_once(1000 + 2 * static_cast<unsigned>(n));
    } else {
      tracker.see(shown, random() % 4 == 0, features, tracked);
      if (shown < gallery::walk) {
        ++result.walked;
        result.followed += tracker.inliers() >= 30;
      }
    }
    if (n == warm_up) { warm = test::measure(); }
    if (n % every == 0 || n + 1 == o.frames) { result.curve.push_back({n + 1, test::measure()}); }
  }
  usage const end = result.curve.back().memory;
  result.growth = {end.resident - warm.resident, end.heap - warm.heap, end.device - warm.device};
  result.first = features.first() + tracked.first();
  result.again = features.again() + tracked.again();
  result.seconds = std::chrono::duration<double>(std::chrono::steady_clock::now() - begin).count();
  return result;
}

// ---- what is said -----------------------------------------------------------------------------

double mebibytes(long long bytes) { return static_cast<double>(bytes) / (1 << 20); }

void print(outcome const& r, options const& o) {
  std::printf("%10s %14s %10s %14s   MiB\n", "frame", "resident", "heap", "device");
  std::size_t const step = std::max<std::size_t>(1, r.curve.size() / 20);
  for (std::size_t i = 0; i < r.curve.size(); i += step) {
    auto const& m = r.curve[i].memory;
    std::printf("%10d %14.2f %10.3f %14.2f\n", r.curve[i].frame, mebibytes(m.resident),
                mebibytes(m.heap), mebibytes(m.device));
  }
  std::printf("%d frames in %.1f s, %d map points\n", o.frames, r.seconds, r.points);
  for (int k = 0; k < kinds; ++k) { std::printf("  %-15s %7d\n", kind_names[k], r.counts[k]); }
  std::printf("frames of the walk with 30 or more inliers: %d of %d\n", r.followed, r.walked);
  std::printf("results seen for the first time: %ld; seen again, all identical: %ld\n", r.first,
              r.again);
  std::printf("growth after the warm-up, KiB: resident %lld, heap %lld, device %lld: %s\n",
              r.growth.resident / 1024, r.growth.heap / 1024, r.growth.device / 1024,
              r.flat() ? "flat" : "MEMORY GROWS");
}

void write(outcome const& r, options const& o, char const* backend) {
  if (!o.curve.empty()) {
    std::ofstream csv(o.curve);
    csv << "frame,resident_bytes,heap_bytes,device_bytes\n";
    for (auto const& s : r.curve) {
      csv << s.frame << ',' << s.memory.resident << ',' << s.memory.heap << ',' << s.memory.device
          << '\n';
    }
  }
  if (!o.summary.empty()) {
    std::ofstream json(o.summary);
    json << "{\"backend\": \"" << backend << "\", \"frames\": " << o.frames
         << ", \"seconds\": " << r.seconds << ", \"map_points\": " << r.points;
    for (int k = 0; k < kinds; ++k) { json << ", \"" << kind_names[k] << "\": " << r.counts[k]; }
    json << ", \"walked\": " << r.walked << ", \"followed\": " << r.followed
         << ", \"results_first\": " << r.first << ", \"results_again_identical\": " << r.again
         << ", \"growth_resident_bytes\": " << r.growth.resident
         << ", \"growth_heap_bytes\": " << r.growth.heap
         << ", \"growth_device_bytes\": " << r.growth.device
         << ", \"flat\": " << (r.flat() ? "true" : "false") << "}\n";
  }
}

options parse(int argc, char** argv) {
  options o;
  for (int i = 1; i < argc; i += 2) {
    std::string const name = argv[i];
    if (i + 1 == argc) { throw std::runtime_error(name + " needs a value"); }
    if (name == "--frames") {
      o.frames = std::atoi(argv[i + 1]);
    } else if (name == "--curve") {
      o.curve = argv[i + 1];
    } else if (name == "--summary") {
      o.summary = argv[i + 1];
    } else {
      throw std::runtime_error("unknown option " + name);
    }
  }
  if (o.frames < 100) { throw std::runtime_error("--frames must be 100 or more"); }
  return o;
}

template <typename Exec>
int run_and_tell(Exec const& exec, options const& o) {
  outcome const r = run(exec, o);
  print(r, o);
  write(r, o, Exec::space == ft::memory_space::host ? "host" : "cuda");
  return r.good() ? EXIT_SUCCESS : EXIT_FAILURE;
}

}  // namespace soak

int main(int argc, char** argv) {
  try {
    auto const options = soak::parse(argc, argv);
    return soak_scene::on_backend(
        [&](auto const& exec) { return soak::run_and_tell(exec, options); });
  } catch (std::exception const& e) {
    std::fprintf(stderr, "soak: %s\n", e.what());
    return EXIT_FAILURE;
  }
}
