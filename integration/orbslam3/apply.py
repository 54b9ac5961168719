#!/usr/bin/env python3
# SPDX-License-Identifier: Apache-2.0
"""Puts ft's calls into the C++ files of ORB-SLAM3 1.0 or a fork of it.

    integration/orbslam3/apply.py ORB_SLAM3

Places are found by the names of functions and members. A place that is not found is told, with the
lines that belong there, and nothing is written. CMakeLists.txt is yours: see README.md.
"""
import pathlib
import re
import sys

ORB = 'ft::orbslam3::'
LEFT = 'mpORBextractorLeft->mpGpu'
EXTRACT = f'    {ORB}extract({LEFT}, *this, [&](int i, const cv::Mat& im) {{ %s; }}, %s);'
LAP = f"""    {ORB}extract({LEFT}, *this, [&](int i, const cv::Mat& im) {{
        const auto& lap = static_cast<KannalaBrandt8*>(i == 0 ? mpCamera : mpCamera2)->mvLappingArea;
        ExtractORB(i, im, lap[0], lap[1]); }}, imLeft, imRight);"""
THREADS = r' *thread threadLeft\(&Frame::ExtractORB,\s*this,\s*0,\s*imLeft,\s*%s.*?threadRight\.join\(\);'
PUSH = '    GetMap()->mChanges.push(this);'
SEARCH = 'mCurrentFrame, mvpLocalMapPoints, th, mpLocalMapper->mbFarPoints, mpLocalMapper->mThFarPoints'


def hook(frame, call, own, unless=''):
    return (f'    if (Gpu* gpu = {unless}{ORB}hooked({frame}))\n'
            f'        return gpu->{call}, [&] {{ return {own}; }});')


# An edit: a regular expression of the place, the lines, and what becomes of place and lines.


def after(place, *lines):
    return place, lines, lambda found, new: f'{found}\n{new}'


def instead(place, *lines):
    return place, lines, lambda found, new: new


def before(place, *lines):
    return place, lines, lambda found, new: f'{new}\n{found}'


def first_line(function, *lines):
    return after(function + r'[^;{]*\{', *lines)


def last_line(function, *lines):
    """The body ends with the first brace in the column of the function."""
    return r'(?ms)^( *)[^\n]*' + function + r'[^;{]*\{.*?^\1\}', lines, \
        lambda found, new: '{0}\n{2}\n{1}'.format(*found.rsplit('\n', 1), new)


def include(name, first):
    return after(r'#include ?["<]' + first + '[">]', f'#include "{name}"')


GPU = include('Gpu.h', r'[^"<>\n]*')  # below the first one
EDITS = {
    'include/ORBextractor.h': [after(r'class ORBextractor\s*\{\s*public:', '    struct Gpu* mpGpu = nullptr;')],
    'include/LoopClosing.h': [instead('bool mnFullBAIdx;', 'int mnFullBAIdx;')],
    'include/Map.h': [
        include('integration/orbslam3/change_queue.hpp', r'[^"<>\n]*'),
        after(r'class Map\s*\{.*?\npublic:', f'    {ORB}map_changes<MapPoint> mChanges;')],
    'include/Tracking.h': [after(r'class Tracking\s*\{\s*public:', '    std::unique_ptr<struct Gpu> mpGpu;',
                                 '    std::string mGpuVocabulary;')],
    'src/MapPoint.cc': [last_line(r'void MapPoint::' + name + r'\(', PUSH) for name in (
        'SetWorldPos', 'SetNormalVector', 'UpdateNormalAndDepth', 'ComputeDistinctiveDescriptors',
        'AddObservation', 'EraseObservation', 'SetBadFlag', 'Replace')],
    'src/Frame.cc': [
        GPU,
        instead(THREADS % '0', EXTRACT % ('ExtractORB(i, im, 0, 0)', 'imLeft, imRight')),
        instead(THREADS % r'static_cast', LAP),
        instead(r' *ExtractORB\(0,\s*imGray,\s*0,\s*0\);', EXTRACT % ('ExtractORB(i, im, 0, 0)', 'imGray')),
        instead(r' *ExtractORB\(0,\s*imGray,\s*0,\s*1000\);', EXTRACT % ('ExtractORB(i, im, 0, 1000)', 'imGray')),
        instead(r'\n *ComputeStereoMatches\(\);', '', '    mb = mbf / K.at<float>(0, 0);',
                f'    {ORB}stereo({LEFT}, *this, [this] {{ ComputeStereoMatches(); }});'),
        instead(r'\n *ComputeStereoFishEyeMatches\(\);', '',
                f'    {ORB}stereo({LEFT}, *this, [this] {{ ComputeStereoFishEyeMatches(); }});'),
        first_line(r'void Frame::ComputeBoW\(', hook('*this', 'compute_bow(*this', 'ComputeBoW()'))],
    'src/ORBmatcher.cc': [
        GPU,
        first_line(r'int ORBmatcher::SearchByProjection\(Frame ?& ?CurrentFrame, const Frame',
                   hook('CurrentFrame', 'search_by_projection(CurrentFrame, LastFrame, th, bMono',
                        'SearchByProjection(CurrentFrame, LastFrame, th, bMono)')),
        first_line(r'int ORBmatcher::SearchByBoW\(KeyFrame ?\* ?pKF, ?Frame',
                   hook('F', 'search_by_bow(*pKF, F, vpMapPointMatches, mfNNratio, mbCheckOrientation',
                        'SearchByBoW(pKF, F, vpMapPointMatches)')),
        first_line(r'int ORBmatcher::SearchByProjection\(Frame ?& ?CurrentFrame, KeyFrame',
                   hook('CurrentFrame', 'search_keyframe(CurrentFrame, *pKF, sAlreadyFound, th, ORBdist',
                        'SearchByProjection(CurrentFrame, pKF, sAlreadyFound, th, ORBdist)'))],
    'src/Optimizer.cc': [
        GPU,
        first_line(r'int Optimizer::PoseOptimization\(',
                   hook('*pFrame', 'pose_optimization(*pFrame', 'PoseOptimization(pFrame)'))] + [
        first_line(r'int Optimizer::PoseInertialOptimization' + of + r'\(',
                   hook('*pFrame', f'inertial_pose_optimization(*pFrame, {ORB}stage::pose_inertial_{name}',
                        f'PoseInertialOptimization{of}(pFrame, bRecInit)', 'bRecInit ? nullptr : '))
        for of, name in (('LastKeyFrame', 'last_keyframe'), ('LastFrame', 'last_frame'))],
    'src/Tracking.cc': [GPU] + [
        before(r' *if ?\(mSensor == System::' + sensor + r'[^\n]*\)\n[^;]*?\bmCurrentFrame = Frame\(mImGray',
               f'    {ORB}follow(*this, mImGray);') for sensor in ('STEREO', 'RGBD', 'MONOCULAR')] + [
        instead(r'\n *int nToMatch ?= ?0;', '', '    const auto inView = [&] {', '    int nToMatch=0;'),
        instead(r' *if ?\(nToMatch ?> ?0\)\n', '    return nToMatch; };', ''),
        instead(r' *int matches = matcher\.SearchByProjection\(mCurrentFrame, mvpLocalMapPoints[^;]*;',
                f'        mpGpu->search_local_points({SEARCH}, [&] {{',
                f'            return inView() == 0 ? 0 : matcher.SearchByProjection({SEARCH}); }});'),
        before(r' *delete pMP;', '                mpGpu->forget(pMP);')] + [
        last_line(r'void Tracking::' + name + r'\(', '    if (mpGpu) mpGpu->reset();')
        for name in ('Reset', 'ResetActiveMap')],
    'src/System.cc': [
        GPU,
        after(r'mpTracker = new Tracking\(.*?\);', '    mpTracker->mGpuVocabulary = strVocFile;'),
        last_line(r'void System::Shutdown\(', '    if (mpTracker->mpGpu) mpTracker->mpGpu->print(std::cerr);')],
}
NEW = {
    'include/Gpu.h': """#pragma once
#include "Frame.h"
#include "KannalaBrandt8.h"
#include "MapPoint.h"
#include "integration/orbslam3/front_end.hpp"
namespace ORB_SLAM3 {
struct Gpu : ft::orbslam3::front_end<ft::orbslam3::types_of<Frame, MapPoint, KannalaBrandt8>> { using front_end::front_end; };
}
""",
    'src/gpu_tracker.cu': '#include "integration/orbslam3/make_tracker.hpp"\n',
}


def main():
    if len(sys.argv) != 2:
        sys.exit(__doc__)
    root = pathlib.Path(sys.argv[1])
    texts, missing = {}, []
    for name, edits in EDITS.items():
        text = (root / name).read_text()
        if 'orbslam3' in text or 'mpGpu' in text:
            sys.exit(f'{name}: ft is there already')
        for place, lines, change in edits:
            new = '\n'.join(lines)
            text, times = re.subn(place, lambda found: change(found[0], new), text, count=1, flags=re.DOTALL)
            if not times:
                missing.append(f'{name}: no place like {place}, for:\n{new}')
        texts[name] = text
    if missing:
        sys.exit('\n'.join(missing) + '\nnothing was written')
    for name, text in {**texts, **NEW}.items():
        (root / name).write_text(text)


if __name__ == '__main__':
    main()
