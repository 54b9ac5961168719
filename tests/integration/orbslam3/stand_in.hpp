// SPDX-License-Identifier: Apache-2.0
/// @file Types of the shape that the shim finds in ORB-SLAM3, written from the list of members in
/// docs/orbslam3.md: enough to compile and test the shim without that system. With
/// FT_TEST_OPENCV images, matrices and keypoints are OpenCV's, otherwise stand-ins as well.
#pragma once

#include <Eigen/Core>
#include <Eigen/Geometry>
#include <array>
#include <cstddef>
#include <cstring>
#include <map>
#include <mutex>
#include <vector>

#include "stand_in_motion.hpp"  // also used by a project outside, without the root in its path
#if FT_TEST_OPENCV
#include <opencv2/core.hpp>
#else
#include <memory>
#endif

namespace stand_in {

#if FT_TEST_OPENCV
using matrix = cv::Mat;
using keypoint = cv::KeyPoint;
using point2f = cv::Point2f;
#else
/// Of cv::Mat: rows of bytes that copies share, and clone().
struct matrix {
  int rows = 0;
  int cols = 0;
  unsigned char* data = nullptr;
  std::size_t step = 0;

  /// @param type 0 = CV_8UC1, 5 = CV_32FC1
  void create(int r, int c, int type) {
    type_ = type;
    rows = r;
    cols = c;
    step = static_cast<std::size_t>(c) * (type == 5 ? 4 : 1);
    memory_ = std::make_shared<std::vector<unsigned char>>(static_cast<std::size_t>(r) * step);
    data = memory_->data();
  }
  /// Fewer rows in the same memory, or more in new memory.
  void resize(std::size_t r) {
    if (r > static_cast<std::size_t>(rows)) {
      matrix larger;
      larger.create(static_cast<int>(r), cols, type_);
      if (data != nullptr) {
        std::memcpy(larger.data, data, static_cast<std::size_t>(rows) * step);
      }
      *this = larger;
    }
    rows = static_cast<int>(r);
  }
  int type() const { return type_; }
  bool empty() const { return data == nullptr; }
  matrix clone() const {
    matrix m;
    if (data != nullptr) {
      m.create(rows, cols, type_);
      std::memcpy(m.data, data, static_cast<std::size_t>(rows) * step);
    }
    return m;
  }

private:
  int type_ = 0;
  std::shared_ptr<std::vector<unsigned char>> memory_;
};
struct point2f {
  float x = 0;
  float y = 0;
  point2f() = default;
  point2f(float a, float b) : x(a), y(b) {}
};
struct keypoint {
  point2f pt;
  float size = 0;
  float angle = -1;
  float response = 0;
  int octave = 0;
  int class_id = -1;
};
#endif

class map_point;

/// What the mapping thread calls where the hooks are in: nothing by default.
struct hooks {
  virtual ~hooks() = default;
  virtual void changed(map_point* point) = 0;
};

/// Of ORB_SLAM3::MapPoint: values under the locks of the original, counters, tracked values.
class map_point {
public:
  unsigned long mnId = 0;
  float mTrackProjX = 0, mTrackProjY = 0, mTrackDepth = 0, mTrackDepthR = 0;
  float mTrackProjXR = 0, mTrackProjYR = 0;
  bool mbTrackInView = false, mbTrackInViewR = false;
  int mnTrackScaleLevel = 0, mnTrackScaleLevelR = 0;
  float mTrackViewCos = 0, mTrackViewCosR = 0;
  unsigned long mnLastFrameSeen = static_cast<unsigned long>(-1);
  inline static std::mutex mGlobalMutex;
  hooks* observer = nullptr;

  Eigen::Vector3f GetWorldPos() {
    std::lock_guard<std::mutex> const lock(mMutexPos);
    return position_;
  }
  Eigen::Vector3f GetNormal() {
    std::lock_guard<std::mutex> const lock(mMutexPos);
    return normal_;
  }
  float GetMinDistanceInvariance() {
    std::lock_guard<std::mutex> const lock(mMutexPos);
    return 0.8f * mfMinDistance;
  }
  float GetMaxDistanceInvariance() {
    std::lock_guard<std::mutex> const lock(mMutexPos);
    return 1.2f * mfMaxDistance;
  }
  /// Not public in the original.
  float raw_max_distance() {
    std::lock_guard<std::mutex> const lock(mMutexPos);
    return mfMaxDistance;
  }
  matrix GetDescriptor() {
    std::lock_guard<std::mutex> const lock(features_mutex_);
    return descriptor_.clone();
  }
  int Observations() {
    std::lock_guard<std::mutex> const lock(features_mutex_);
    return observations_;
  }
  bool isBad() {
    std::lock_guard<std::mutex> const features(features_mutex_);
    std::lock_guard<std::mutex> const position(mMutexPos);
    return bad_;
  }
  void IncreaseVisible(int n = 1) {
    std::lock_guard<std::mutex> const lock(features_mutex_);
    visible_ += n;
  }
  int visible() {
    std::lock_guard<std::mutex> const lock(features_mutex_);
    return visible_;
  }

  // What the mapping thread calls. The hook is the last line of each.
  void SetWorldPos(Eigen::Vector3f const& p) {
    {
      std::lock_guard<std::mutex> const global(mGlobalMutex);
      std::lock_guard<std::mutex> const lock(mMutexPos);
      position_ = p;
    }
    changed();
  }
  void set_view(Eigen::Vector3f const& normal, float min_distance, float max_distance) {
    {
      std::lock_guard<std::mutex> const lock(mMutexPos);
      normal_ = normal;
      mfMinDistance = min_distance;
      mfMaxDistance = max_distance;
    }
    changed();
  }
  void set_descriptor(unsigned char const* bytes) {
    {
      std::lock_guard<std::mutex> const lock(features_mutex_);
      matrix fresh;  // readers may hold a copy of the header
      fresh.create(1, 32, 0);
      std::memcpy(fresh.data, bytes, 32);
      descriptor_ = fresh;
    }
    changed();
  }
  void set_observations(int n) {
    {
      std::lock_guard<std::mutex> const lock(features_mutex_);
      observations_ = n;
    }
    changed();
  }
  void SetBadFlag() {
    {
      std::lock_guard<std::mutex> const features(features_mutex_);
      std::lock_guard<std::mutex> const position(mMutexPos);
      bad_ = true;
    }
    changed();
  }
  void Replace(map_point* by) {
    {
      std::lock_guard<std::mutex> const features(features_mutex_);
      std::lock_guard<std::mutex> const position(mMutexPos);
      bad_ = true;
      replaced_ = by;
    }
    changed();
  }
  map_point* GetReplaced() {
    std::lock_guard<std::mutex> const features(features_mutex_);
    return replaced_;
  }

protected:
  float mfMinDistance = 0;
  float mfMaxDistance = 0;
  std::mutex mMutexPos;

private:
  void changed() {
    if (observer != nullptr) { observer->changed(this); }
  }

  std::mutex features_mutex_;
  Eigen::Vector3f position_ = Eigen::Vector3f::Zero();
  Eigen::Vector3f normal_ = Eigen::Vector3f::Zero();
  matrix descriptor_;
  int observations_ = 1;
  int visible_ = 1;
  bool bad_ = false;
  map_point* replaced_ = nullptr;
};

/// Of ORB_SLAM3::GeometricCamera.
struct camera {
  unsigned type = 0;
  std::vector<float> parameters;
  unsigned GetType() const { return type; }
  float getParameter(int i) const { return parameters[static_cast<std::size_t>(i)]; }
};

/// Of ORB_SLAM3::KannalaBrandt8.
struct fisheye_camera : camera {
  std::vector<int> mvLappingArea = {0, 0};
};

/// Of DBoW2: words with their values, and the keypoints of each node.
class bow_vector : public std::map<unsigned, double> {};
class feature_vector : public std::map<unsigned, std::vector<unsigned>> {};

/// Of ORB_SLAM3::KeyFrame.
struct key_frame {
  se3 T_cw;
  Eigen::Vector3f velocity = Eigen::Vector3f::Zero();
  bias imu_bias;
  unsigned long mnFrameId = 0;
  int NLeft = -1;
  std::vector<keypoint> mvKeys, mvKeysUn, mvKeysRight;
  matrix mDescriptors;
  bow_vector mBowVec;
  feature_vector mFeatVec;
  std::vector<map_point*> points;  ///< mvpMapPoints, which is not public

  se3 GetPose() const { return T_cw; }
  Eigen::Vector3f GetVelocity() const { return velocity; }
  bias GetImuBias() const { return imu_bias; }
  std::vector<map_point*> GetMapPointMatches() const { return points; }
};

struct gpu;  ///< of the tests that need it

/// Of ORB_SLAM3::ORBextractor.
class extractor {
public:
  gpu* mpGpu = nullptr;

  extractor(int features, float scale_factor, int levels, int ini_threshold, int min_threshold)
      : nfeatures(features),
        scaleFactor(static_cast<double>(scale_factor)),
        nlevels(levels),
        iniThFAST(ini_threshold),
        minThFAST(min_threshold) {}
  int GetLevels() const { return nlevels; }
  float GetScaleFactor() const { return static_cast<float>(scaleFactor); }

protected:
  int nfeatures;
  double scaleFactor;
  int nlevels;
  int iniThFAST;
  int minThFAST;
};

/// Of ORB_SLAM3::Frame. Its constructors give the members their values: see constructors.hpp.
struct frame {
  unsigned long mnId = 0;
  int N = garbage;
  int Nleft = garbage;
  int Nright = garbage;
  int monoLeft = garbage;
  int monoRight = garbage;
  int mnCloseMPs = garbage;
  std::vector<keypoint> mvKeys;
  std::vector<keypoint> mvKeysRight;
  std::vector<keypoint> mvKeysUn;
  matrix mK;  ///< set before the constructor's body, like the next
  matrix mDistCoef;
  std::vector<std::size_t> mGrid[64][48];
  std::vector<std::size_t> mGridRight[64][48];
  matrix mDescriptors;
  matrix mDescriptorsRight;
  std::vector<float> mvuRight;
  std::vector<float> mvDepth;
  std::vector<int> mvLeftToRightMatch;
  std::vector<int> mvRightToLeftMatch;
  std::vector<Eigen::Vector3f> mvStereo3Dpoints;
  std::vector<map_point*> mvpMapPoints;
  std::vector<bool> mvbOutlier;
  std::map<unsigned long, point2f> mmProjectPoints;
  bow_vector mBowVec;
  feature_vector mFeatVec;
  int mnScaleLevels = garbage;
  float mfScaleFactor = garbage_number;
  float mfLogScaleFactor = garbage_number;
  std::vector<float> mvScaleFactors;
  std::vector<float> mvInvScaleFactors;
  std::vector<float> mvLevelSigma2;
  std::vector<float> mvInvLevelSigma2;
  extractor* mpORBextractorLeft = nullptr;
  // Static in the original.
  float mnMinX = 0, mnMinY = 0, mnMaxX = 0, mnMaxY = 0;

  bias mImuBias;
  calibration mImuCalib;
  preintegrated* mpImuPreintegrated = nullptr;  ///< since the last keyframe
  key_frame* mpLastKeyFrame = nullptr;
  frame* mpPrevFrame = nullptr;
  preintegrated* mpImuPreintegratedFrame = nullptr;  ///< since the last frame
  pose_constraint* mpcpi = nullptr;                  ///< copies of a frame share it

  se3 GetPose() const { return T_cw; }
  void SetPose(se3 const& T) { T_cw = T; }
  se3 GetRelativePoseTlr() { return T_lr; }
  Eigen::Vector3f GetVelocity() const { return velocity_; }
  void SetVelocity(Eigen::Vector3f v) { velocity_ = v; }

  se3 T_cw;
  se3 T_lr;  ///< right camera to left camera, of a fisheye pair

private:
  Eigen::Vector3f velocity_{garbage_number, garbage_number, garbage_number};
};

struct types {
  using frame = stand_in::frame;
  using map_point = stand_in::map_point;
  using fisheye_camera = stand_in::fisheye_camera;
};

}  // namespace stand_in
