#!/usr/bin/env python3
# SPDX-License-Identifier: Apache-2.0
"""integration/orbslam3/apply.py on stand-ins of ORB-SLAM3's files: every line is at its place, a file
that lacks one is told of and nothing is written, and ft is not put in twice."""
import pathlib
import subprocess
import sys
import tempfile

APPLY = pathlib.Path(__file__).parents[2] / 'integration/orbslam3/apply.py'
POINT = ('SetWorldPos', 'SetNormalVector', 'UpdateNormalAndDepth', 'ComputeDistinctiveDescriptors',
         'AddObservation', 'EraseObservation', 'SetBadFlag', 'Replace')
THREADS = '''    thread threadLeft(&Frame::ExtractORB,this,0,imLeft,{0});
    thread threadRight(&Frame::ExtractORB,this,1,imRight,{0});
    threadLeft.join();
    threadRight.join();
'''
LAP = 'static_cast<KannalaBrandt8*>(mpCamera)->mvLappingArea[0],static_cast<KannalaBrandt8*>(mpCamera)->mvLappingArea[1]'
FILES = {
    'include/ORBextractor.h': '#include <list>\nclass ORBextractor\n{\npublic:\n    int a;\n};\n',
    'include/LoopClosing.h': '#include <list>\nclass LoopClosing\n{\n    bool mnFullBAIdx;\n};\n',
    'include/Map.h': '#include "MapPoint.h"\nclass MapPoint;\nclass Map\n{\n    int a;\n\npublic:\n    Map();\n};\n',
    'include/Tracking.h': '#include "Viewer.h"\nclass Tracking\n{\n\npublic:\n    int a;\n};\n',
    'src/MapPoint.cc': '#include "MapPoint.h"\n' + ''.join(
        f'void MapPoint::{name}(int a)\n{{\n    if (a)\n    {{\n        return;\n    }}\n    // end of {name}\n}}\n' for name in POINT),
    'src/Frame.cc': '#include "Frame.h"\nFrame::Frame(int a)\n{\n' + THREADS.format('0,0') + '''
    ComputeStereoMatches();
}
Frame::Frame(char a)
{
    ExtractORB(0,imGray,0,0);
}
Frame::Frame(long a)
{
    ExtractORB(0,imGray,0,1000);
}
void Frame::ComputeBoW()
{
    // words
}
void Frame::ComputeStereoMatches()
{
}
Frame::Frame(short a)
{
''' + THREADS.format(LAP) + '''
    ComputeStereoFishEyeMatches();
}
''',
    'src/ORBmatcher.cc': '''#include "ORBmatcher.h"
    int ORBmatcher::SearchByBoW(KeyFrame* pKF,Frame &F, vector<MapPoint*> &vpMapPointMatches)
    {
    }
    int ORBmatcher::SearchByBoW(KeyFrame *pKF1, KeyFrame *pKF2, vector<MapPoint *> &vpMatches12)
    {
    }
    int ORBmatcher::SearchByProjection(Frame &CurrentFrame, const Frame &LastFrame, const float th, const bool bMono)
    {
    }
    int ORBmatcher::SearchByProjection(Frame &CurrentFrame, KeyFrame *pKF, const set<MapPoint*> &sAlreadyFound, const float th , const int ORBdist)
    {
    }
''',
    'src/Optimizer.cc': '#include "Optimizer.h"\n' + ''.join(
        f'int Optimizer::{name})\n{{\n    // own\n}}\n' for name in
        ('PoseOptimization(Frame *pFrame', 'PoseInertialOptimizationLastKeyFrame(Frame *pFrame, bool bRecInit',
         'PoseInertialOptimizationLastFrame(Frame *pFrame, bool bRecInit')),
    'src/Tracking.cc': '#include "Tracking.h"\n' + ''.join(f'''void Tracking::GrabImage{kind}()
{{
    if (mSensor == System::{kind})
        mCurrentFrame = Frame(mImGray,{kind});
}}
''' for kind in ('STEREO', 'RGBD', 'MONOCULAR')) + '''void Tracking::SearchLocalPoints()
{
    int nToMatch=0;

    for (;;)
    {
        nToMatch++;
    }

    if(nToMatch>0)
    {
        ORBmatcher matcher(0.8);
        int matches = matcher.SearchByProjection(mCurrentFrame, mvpLocalMapPoints, th, a, b);
    }
}
void Tracking::Track()
{
                delete pMP;
}
void Tracking::Reset(bool bLocMap)
{
}
void Tracking::ResetActiveMap(bool bLocMap)
{
}
''',
    'src/System.cc': '''#include "System.h"
System::System()
{
    mpTracker = new Tracking(this, a,
                             b);
}
void System::Shutdown()
{
    // shut down
}
''',
}
# Parts of the result, each once, with what is beside it.
WANTED = {
    'include/ORBextractor.h': ['public:\n    struct Gpu* mpGpu = nullptr;\n    int a;'],
    'include/LoopClosing.h': ['    int mnFullBAIdx;'],
    'include/Map.h': ['public:\n    ft::orbslam3::map_changes<MapPoint> mChanges;\n    Map();',
                      '#include "MapPoint.h"\n#include "integration/orbslam3/change_queue.hpp"\n'],
    'include/Tracking.h': ['public:\n    std::unique_ptr<struct Gpu> mpGpu;\n    std::string mGpuVocabulary;\n'],
    'src/MapPoint.cc': [f'    // end of {name}\n    GetMap()->mChanges.push(this);\n}}\n' for name in POINT],
    'src/Frame.cc': ['{ ExtractORB(i, im, 0, 0); }, imLeft, imRight);\n\n    mb = mbf / K.at<float>(0, 0);\n'
                     '    ft::orbslam3::stereo(mpORBextractorLeft->mpGpu, *this, [this] { ComputeStereoMatches(); });\n}',
                     '{ ExtractORB(i, im, 0, 0); }, imGray);\n}', '{ ExtractORB(i, im, 0, 1000); }, imGray);\n}',
                     'ExtractORB(i, im, lap[0], lap[1]); }, imLeft, imRight);\n',
                     '[this] { ComputeStereoFishEyeMatches(); });\n',
                     'void Frame::ComputeBoW()\n{\n    if (Gpu* gpu = ft::orbslam3::hooked(*this))\n',
                     'void Frame::ComputeStereoMatches()\n{\n}'],
    'src/ORBmatcher.cc': ['hooked(F))\n        return gpu->search_by_bow(*pKF, F,',
                          'bMono)\n    {\n    if (Gpu* gpu = ft::orbslam3::hooked(CurrentFrame))\n        return gpu->search_by_projection(',
                          'ORBdist)\n    {\n    if (Gpu* gpu = ft::orbslam3::hooked(CurrentFrame))\n        return gpu->search_keyframe(',
                          'vpMatches12)\n    {\n    }'],
    'src/Optimizer.cc': ['hooked(*pFrame))\n        return gpu->pose_optimization(*pFrame, [&] { return PoseOptimization(pFrame); });',
                         'stage::pose_inertial_last_keyframe, [&] { return PoseInertialOptimizationLastKeyFrame(pFrame, bRecInit); });',
                         'stage::pose_inertial_last_frame, [&] { return PoseInertialOptimizationLastFrame(pFrame, bRecInit); });'],
    'src/Tracking.cc': [f'    ft::orbslam3::follow(*this, mImGray);\n    if (mSensor == System::{kind})' for kind in
                        ('STEREO', 'RGBD', 'MONOCULAR')] + [
                            '    const auto inView = [&] {\n    int nToMatch=0;\n', '    return nToMatch; };\n    {\n',
                            'return inView() == 0 ? 0 : matcher.SearchByProjection(', 'mpGpu->forget(pMP);\n                delete pMP;',
                            'Reset(bool bLocMap)\n{\n    if (mpGpu) mpGpu->reset();\n}',
                            'ResetActiveMap(bool bLocMap)\n{\n    if (mpGpu) mpGpu->reset();\n}'],
    'src/System.cc': ['b);\n    mpTracker->mGpuVocabulary = strVocFile;\n}',
                      '    // shut down\n    if (mpTracker->mpGpu) mpTracker->mpGpu->print(std::cerr);\n}'],
    'include/Gpu.h': ['struct Gpu : '],
    'src/gpu_tracker.cu': ['make_tracker.hpp'],
}


def write(root, files):
    for name, text in files.items():
        path = root / name
        path.parent.mkdir(parents=True, exist_ok=True)
        path.write_text(text)


def apply(root):
    return subprocess.run([sys.executable, APPLY, root], capture_output=True, text=True)


def main():
    errors = []
    with tempfile.TemporaryDirectory() as folder:
        root = pathlib.Path(folder)
        write(root, FILES)
        first = apply(root)
        if first.returncode != 0:
            errors.append('it refuses the stand-ins: ' + first.stderr)
        for name, parts in WANTED.items():
            text = (root / name).read_text() if (root / name).exists() else ''
            errors += [f'{name}: {text.count(part)} times: {part}' for part in parts if text.count(part) != 1]
        again = apply(root)
        if again.returncode == 0 or 'ft is there already' not in again.stderr:
            errors.append('it is applied twice')
    with tempfile.TemporaryDirectory() as folder:
        root = pathlib.Path(folder)
        without = dict(FILES, **{'src/System.cc': FILES['src/System.cc'].replace('Shutdown', 'End')})
        write(root, without)
        refused = apply(root)
        if refused.returncode == 0 or 'mpGpu->print(std::cerr)' not in refused.stderr:
            errors.append('a place that is missing is not told: ' + refused.stderr)
        if any((root / name).read_text() != text for name, text in without.items()) or (root / 'include/Gpu.h').exists():
            errors.append('it writes although a place is missing')
    print('\n'.join(errors) if errors else 'apply.py: every line at its place')
    return 1 if errors else 0


if __name__ == '__main__':
    sys.exit(main())
