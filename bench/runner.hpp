// SPDX-License-Identifier: Apache-2.0
/// @file Interfaces of the measurements, without types of ft. The templates are instantiated behind
/// them, once per executor and rig.
#pragma once

#include <cstddef>
#include <memory>
#include <stdexcept>
#include <string>
#include <vector>

#include "bench/scene.hpp"

namespace bench {

enum class backend_type { host, cuda };
inline char const* name_of(backend_type b) { return b == backend_type::host ? "host" : "cuda"; }
inline char const* name_of(rig_type r) {
  return r == rig_type::rectified ? "rectified"
         : r == rig_type::fisheye ? "fisheye"
                                  : "four cameras";
}

/// The memory is too small for a measurement.
struct no_memory : std::runtime_error {
  using std::runtime_error::runtime_error;
};

// ---- whole frames -----------------------------------------------------------------------------

struct frame_options {
  backend_type backend = backend_type::host;
  int host_threads = 0;  ///< of the host executor, 0 = all
  int batch = 1;         ///< camera pairs
  bool optimize_last = true;
  bool optimize_local = true;
  bool std_sort_ties = false;  ///< of the quadtree
  bool use_graphs = true;      ///< false: enqueue each launch
  bool measure_stages = false;
  bool imu = false;  ///< an odometry of rectified pairs has the scene's IMU
  int prefetch = 0;  ///< frames that an odometry gets early
};

/// How a frame is enqueued.
enum class call_type {
  whole,       ///< one call, on a device one graph
  two_halves,  ///< two calls; the host waits in between, as if to choose the local map
};

/// Means over the scene's frames, of the batch's first pair.
struct frame_counts {
  double keypoints = 0;       ///< of the left image
  double stereo_matches = 0;  ///< left keypoints with a depth
  double last_matches = 0;    ///< of the search from the last frame
  double last_inliers = 0;    ///< of its pose optimisation; the matches if there is none
  double local_matches = 0;   ///< of the search in the local map
  double inliers = 0;         ///< of the second pose optimisation; the matches if there is none
  double position_error = 0;  ///< of the frame's camera centre, metres
  int map_points = 0;
};

/// Contents of a recorded frame. All zero on the host.
struct graph_counts {
  int kernels = 0, copies = 0, fills = 0, others = 0;
  std::size_t bytes_up = 0;      ///< copied from host memory
  std::size_t bytes_down = 0;    ///< copied to host memory
  std::size_t bytes_within = 0;  ///< copied on the device
  std::size_t result_bytes = 0;  ///< of the result, which kernels write to host memory
};

/// One kernel of a recorded frame, as the driver reports it.
struct kernel_facts {
  std::string name;
  int launches = 0;         ///< in a frame
  int threads = 0;          ///< per block
  int blocks = 0;           ///< of the largest launch
  int registers = 0;        ///< per thread
  std::size_t shared = 0;   ///< static, bytes per block
  std::size_t local = 0;    ///< bytes per thread: spills and arrays
  int threads_per_sm = 0;   ///< most resident threads of this kernel
  int most_threads_sm = 0;  ///< most resident threads of the device
};

/// Time of a stage, microseconds.
struct stage_us {
  std::string name;
  double us;
};

/// A tracker over a batch of pairs that see the scene's frames, against a map of points of all
/// frames. Each pair sees the frame after that of the preceding pair. Order of calls per frame:
/// prepare, launch, wait (or poll done()).
class frame_runner {
public:
  frame_runner() = default;
  frame_runner(frame_runner const&) = delete;
  frame_runner& operator=(frame_runner const&) = delete;
  virtual ~frame_runner() = default;

  /// Writes images, prediction and last frame of frame `i` to memory from which the executor reads
  /// them.
  virtual void prepare(int i) = 0;
  /// True (the default): images are in pinned memory, like those of a camera, and prepare() borrows
  /// them. False: prepare() copies them to the tracker's staging memory, so they are in the caches
  /// of its core.
  virtual void borrow_images(bool borrow) = 0;
  /// Enqueues the frame. On the host, returns when it is done.
  virtual void launch(call_type how) = 0;
  virtual bool done() = 0;
  virtual void wait() = 0;
  /// Enqueues the writing of the first `count` map points of pair 0. Waits for the preceding
  /// update.
  virtual void update_map(int count) = 0;
  /// Enqueues the writing of only the positions of the first `count` map points of pair 0: one
  /// copy. Waits for the preceding update.
  virtual void update_positions(int count) = 0;
  virtual int map_points() const = 0;

  /// Runs every frame of the scene in two halves and counts its results.
  virtual frame_counts counts() = 0;
  /// Runs one frame; returns the time that each stage adds to it, in order. Needs
  /// frame_options::measure_stages.
  virtual std::vector<stage_us> stage_times(int i) = 0;
  /// Both need frame_options::use_graphs to be off: they capture the launches that the recorded
  /// graph has, of a batch as if its images were uploaded at once.
  virtual graph_counts graph() = 0;
  virtual std::vector<kernel_facts> kernels() = 0;
};

/// @throws no_memory, std::runtime_error
std::unique_ptr<frame_runner> make_frame_runner(scene const& s, frame_options const& how);

// ---- odometry ---------------------------------------------------------------------------------

/// What the last frame of an odometry was.
struct odometry_counts {
  int tracked = 0;    ///< cameras of the batch
  int keyframes = 0;  ///< cameras whose frame became a keyframe
  int by_imu = 0;     ///< cameras whose pose was optimised with the IMU
  int inliers = 0;    ///< these and the others: of the first camera
  int local_points = 0;
  int map_points = 0;
  int maps = 0;
};

/// ft::odometry over a batch of rectified pairs, or of rigs of two, that see the scene's frames
/// back and forth, each one frame further on than the preceding one. Images are in memory that the
/// executor reads.
class odometry_runner {
public:
  odometry_runner() = default;
  odometry_runner(odometry_runner const&) = delete;
  odometry_runner& operator=(odometry_runner const&) = delete;
  virtual ~odometry_runner() = default;

  /// Chooses the images of frame i, which is the one after the last, and hands over the IMU's
  /// samples before it. @param i from 0; with an IMU only forward: less than the scene's frames
  virtual void prepare(int i) = 0;
  virtual void track() = 0;  ///< synchronous
  virtual odometry_counts last() const = 0;
  /// Time of each stage of the last frame, in order. Needs frame_options::measure_stages.
  virtual std::vector<stage_us> stage_times() const = 0;
  /// Of the executor, as the odometry tells.
  virtual double memory_bytes() const = 0;
};

/// Bytes of the current device that are in use: by programs, contexts and the driver.
double device_bytes_in_use();

/// Memory of an odometry of one camera pair, by what it is for.
struct odometry_memory_row {
  std::string what;
  int count;              ///< by default
  double executor_bytes;  ///< of each
  double staging_bytes;
};
/// The last row is the whole. @param s its image size and number of features are used
std::vector<odometry_memory_row> odometry_memory(scene const& s);

/// @param how its backend, threads, batch, graphs and stage times are used @throws no_memory,
/// std::runtime_error
std::unique_ptr<odometry_runner> make_odometry_runner(scene const& s, frame_options const& how);

// ---- camera models ----------------------------------------------------------------------------

struct camera_case {
  std::string model;   ///< "(copy)": no camera, the same memory traffic as project
  std::string scalar;  ///< "float" or "strict_float"
  std::string op;      ///< "project", "project_with_jacobian" or "unproject"
};

/// Runs camera models over sets of different points in the field of view.
class camera_runner {
public:
  camera_runner() = default;
  camera_runner(camera_runner const&) = delete;
  camera_runner& operator=(camera_runner const&) = delete;
  virtual ~camera_runner() = default;

  virtual std::vector<camera_case> const& cases() const = 0;
  /// Creates the points for a case, unless the preceding case had the same model.
  virtual void select(int number) = 0;
  /// Time of `launches` launches of the selected case, over the sets in turn beginning with
  /// `first`; microseconds for all.
  virtual double run(int first, int launches) = 0;
  /// Share of the points with a valid result in the last launch of the selected case.
  virtual double valid_share() = 0;
};

/// @param points per set
/// @param sets number of sets
std::unique_ptr<camera_runner> make_camera_runner(backend_type backend, int host_threads,
                                                  int points, int sets);

// ---- bundle adjustment ------------------------------------------------------------------------

struct window_case {
  backend_type backend = backend_type::host;
  int host_threads = 0;  ///< of the host executor, 0 = all
  int batch = 1;         ///< problems
  int views = 13;
  int fixed = 5;  ///< of these
  int points = 2000;
  int steps = 3;
};

/// Adjusts a batch of windows, each time from the same start.
class window_runner {
public:
  window_runner() = default;
  window_runner(window_runner const&) = delete;
  window_runner& operator=(window_runner const&) = delete;
  virtual ~window_runner() = default;

  /// Time of one adjustment of all problems, microseconds.
  virtual double run() = 0;
  /// Share of the cost that the last run took away, of the problem with the smallest.
  virtual double gained() = 0;
};

/// @throws std::runtime_error
std::unique_ptr<window_runner> make_window_runner(window_case const& what);

// ---- matching descriptors -----------------------------------------------------------------------

inline constexpr char const* matching_models[] = {"binary_128", "binary_256", "binary_488",
                                                  "binary_512", "int8_128",   "float16_128",
                                                  "float_64",   "float_128"};

struct matching_case {
  backend_type backend = backend_type::host;
  int host_threads = 0;  ///< of the host executor, 0 = all
  std::string model;     ///< one of matching_models
  int rows = 1000;       ///< query rows, and train rows
  bool mutual = true;
};

/// Matches the same rows again and again, all with all.
class matching_runner {
public:
  matching_runner() = default;
  matching_runner(matching_runner const&) = delete;
  matching_runner& operator=(matching_runner const&) = delete;
  virtual ~matching_runner() = default;

  /// Time of one call, microseconds.
  virtual double run() = 0;
  /// Share of the query rows whose match was accepted; half of them have one.
  virtual double matched_share() = 0;
};

/// @throws std::runtime_error
std::unique_ptr<matching_runner> make_matching_runner(matching_case const& what);

// ---- poses with an IMU --------------------------------------------------------------------------

struct inertial_case {
  backend_type backend = backend_type::host;
  int host_threads = 0;  ///< of the host executor, 0 = all
  int problems = 1;
  int observations = 150;  ///< of a problem; 0: the IMU's measurements are integrated, no more
  int steps = 10;          ///< of an integral
  bool from_last_frame = false;  ///< with its prior; otherwise from a keyframe
};

/// Solves a batch of poses, or makes a batch of integrals, each time from the same start.
class inertial_runner {
public:
  inertial_runner() = default;
  inertial_runner(inertial_runner const&) = delete;
  inertial_runner& operator=(inertial_runner const&) = delete;
  virtual ~inertial_runner() = default;

  /// Time of one call for all problems, microseconds.
  virtual double run() = 0;
  /// Share of the observations that are inliers, of the problem with the smallest; 1 for integrals.
  virtual double inlier_share() = 0;
};

/// @throws std::runtime_error
std::unique_ptr<inertial_runner> make_inertial_runner(inertial_case const& what);

// ---- words, relocalisation, a start with one camera ---------------------------------------------

enum class words_stage {
  transform,   ///< of frames of 1200 descriptors
  query,       ///< of one frame, to a database of keyframes
  search,      ///< by words, between one frame and keyframes
  solve,       ///< poses of candidates, 100 correspondences each, all hypotheses
  relocalize,  ///< one frame, against candidates of which the last one sees its place
  two_views,   ///< a motion and points, from the matches of a search
  start,       ///< the same with the grid and the search before it: ft::monocular_start::add()
};

struct words_case {
  backend_type backend = backend_type::host;
  words_stage stage = words_stage::transform;
  int count = 1;   ///< frames of a transform; else keyframes or candidates; pairs: 1
  int levels = 6;  ///< of the vocabulary, whose nodes have ten children
};

/// Calls a stage with eight inputs in turn. On the host with one thread.
class words_runner {
public:
  static constexpr int inputs = 8;

  words_runner() = default;
  words_runner(words_runner const&) = delete;
  words_runner& operator=(words_runner const&) = delete;
  virtual ~words_runner() = default;

  /// Time of a call with the next input, microseconds. Of a relocalisation by the wall clock.
  virtual double run() = 0;
  /// What the last call found: words of a frame, places, matches, inliers or points.
  /// @throws std::runtime_error if it is not what the input shows
  virtual int found() = 0;
};

/// @throws std::runtime_error
std::unique_ptr<words_runner> make_words_runner(words_case const& what);

// ---- the machine ------------------------------------------------------------------------------

/// "name, driver for CUDA x, runtime y"; empty without a device.
std::string cuda_description();
/// Devices that there are; 0 without CUDA.
int cuda_devices();
/// Makes this thread use a device, for the runners that it makes. @throws ft::cuda_error
void use_cuda_device(int device);

}  // namespace bench
