/* mujoco_read.h: reads the file of a model, MJCF or URDF. */
#ifndef ZENDSP_MUJOCO_READ_H
#define ZENDSP_MUJOCO_READ_H

#include <math.h>    /* NAN */
#include <stdio.h>   /* snprintf */
#include <string.h>  /* strcmp, strrchr, strstr */
#include <strings.h> /* strcasecmp */

#include <mujoco/mujoco.h>

static int is_urdf(const char *file) {
    const char *kind = strrchr(file, '.');
    return kind && strcasecmp(kind, ".urdf") == 0;
}

/* 1: no joint moves it. */
static int stands(mjSpec *spec, mjsBody *body) {
    const mjsBody *world = mjs_findBody(spec, "world");
    for (; body && body != world; body = mjs_getParent(body->element))
        if (mjs_firstChild(body, mjOBJ_JOINT, 0))
            return 0;
    return 1;
}

/* The inertia of what stands plays no part: many a base_link has one that no body has. */
static void forget_inertia_that_stands(mjSpec *spec) {
    for (mjsElement *e = mjs_firstElement(spec, mjOBJ_BODY); e; e = mjs_nextElement(spec, e)) {
        mjsBody *body = mjs_asBody(e);
        if (stands(spec, body)) {
            body->explicitinertial = 0;
            body->fullinertia[0] = NAN;
        }
    }
}

/* MuJoCo lets links that a joint connects pass through one another, but for those at a base that
 * stands: there the shapes of a URDF, which meet in the joint, would jam it. Returns how many such
 * pairs are to pass now too. */
static int free_first_links(mjSpec *spec, const mjModel *m) {
    int pairs = 0;
    for (int b = 1; b < m->nbody; b++) {
        if (m->body_weldid[b] == 0 || m->body_weldid[m->body_parentid[b]] != 0 ||
            m->body_jntnum[b] == 0 || m->jnt_type[m->body_jntadr[b]] == mjJNT_FREE)
            continue;
        for (int s = 0; s < m->nbody; s++)
            if (m->body_weldid[s] == 0 && m->body_geomnum[s] > 0) {
                mjsExclude *pair = mjs_addExclude(spec);
                mjs_setString(pair->bodyname1, m->names + m->name_bodyadr[s]);
                mjs_setString(pair->bodyname2, m->names + m->name_bodyadr[b]);
                pairs++;
            }
    }
    return pairs;
}

/* 1: a name is one of a list by comma. */
static int listed(const char *list, const char *name) {
    const size_t length = strlen(name);
    for (const char *at = list; length > 0 && (at = strstr(at, name)); at += length)
        if ((at == list || strchr(", ", at[-1])) && (!at[length] || strchr(", ", at[length])))
            return 1;
    return 0;
}

/* 1: an equality, as of <mimic>, ties a joint to one of the list. */
static int tied(mjSpec *spec, const char *name, const char *list) {
    for (mjsElement *e = mjs_firstElement(spec, mjOBJ_EQUALITY); e; e = mjs_nextElement(spec, e)) {
        const mjsEquality *tie = mjs_asEquality(e);
        const char *one = mjs_getString(tie->name1), *other = mjs_getString(tie->name2);
        if (tie->type == mjEQ_JOINT && ((strcmp(one, name) == 0 && listed(list, other)) ||
                                        (strcmp(other, name) == 0 && listed(list, one))))
            return 1;
    }
    return 0;
}

/* Every joint of a URDF has a motor: those that are not chosen stand at their zero, as behind their
 * brakes, and would fall limp else. Returns how many. */
static int hold_others(mjSpec *spec, const char *list) {
    int held = 0;
    for (mjsElement *e = mjs_firstElement(spec, mjOBJ_JOINT), *next; e; e = next) {
        const char *name = mjs_getString(mjs_getName(e));
        next = mjs_nextElement(spec, e);
        if (mjs_asJoint(e)->type == mjJNT_FREE || listed(list, name) || tied(spec, name, list))
            continue;
        for (mjsElement *t = mjs_firstElement(spec, mjOBJ_EQUALITY), *after; t; t = after) {
            const mjsEquality *tie = mjs_asEquality(t);
            after = mjs_nextElement(spec, t);
            if (tie->type == mjEQ_JOINT && (strcmp(mjs_getString(tie->name1), name) == 0 ||
                                            strcmp(mjs_getString(tie->name2), name) == 0))
                mjs_delete(spec, t);
        }
        held += mjs_delete(spec, e) == 0;
    }
    return held;
}

/* 1: all of a list are joints of the spec. */
static int known(mjSpec *spec, const char *list) {
    char names[1024];
    snprintf(names, sizeof names, "%s", list);
    for (char *rest = names, *name; (name = strtok_r(rest, ", ", &rest));)
        if (!mjs_findElement(spec, mjOBJ_JOINT, name))
            return 0;
    return list[0] != 0;
}

/* A URDF with or without its shapes, whose files are often named by packages that are not here: it
 * states the inertias of its links. NULL: why. */
static mjModel *read_urdf(const char *file, const char *joints, int shapes, int *held, char *why,
                          size_t size) {
    mjSpec *spec = mj_parseXML(file, NULL, why, (int)size);
    if (!spec)
        return NULL;
    const mjtObj kinds[] = {mjOBJ_GEOM, mjOBJ_MESH};
    for (size_t k = 0; !shapes && k < sizeof kinds / sizeof kinds[0]; k++)
        for (mjsElement *e = mjs_firstElement(spec, kinds[k]); e;
             e = mjs_firstElement(spec, kinds[k]))
            if (mjs_delete(spec, e) != 0)
                break;
    *held = known(spec, joints) ? hold_others(spec, joints) : 0;
    forget_inertia_that_stands(spec);
    mjModel *model = mj_compile(spec, NULL);
    if (model && free_first_links(spec, model) > 0) {
        mj_deleteModel(model);
        model = mj_compile(spec, NULL);
    }
    if (!model)
        snprintf(why, size, "%s", mjs_getError(spec));
    mj_deleteSpec(spec);
    return model;
}

/* Takes from MuJoCo's sentence what is of no use to who has the file only. */
static void trim(char *text) {
    char *fused = strstr(text, "The static bodies of the spec were fused");
    if (fused)
        *fused = 0;
    for (char *end = text + strlen(text); end > text && (end[-1] == ' ' || end[-1] == '\n');)
        *--end = 0;
}

/* The model of a file; NULL: why. Of a URDF, joints are those that are
 * chosen by name (empty: none is), and held is how many others are. */
static mjModel *read_model(const char *file, const char *joints, int *shapeless, int *held,
                           char *why, size_t size) {
    char first[400] = "", text[400] = "";
    mjModel *model = is_urdf(file)
                         ? read_urdf(file, joints, 1, held, first, sizeof first)
                         : mj_loadXML(file, NULL, first, (int)sizeof first);
    if (!model && is_urdf(file)) {
        model = read_urdf(file, joints, 0, held, text, sizeof text);
        *shapeless = model != NULL;
    }
    if (model)
        return model;
    trim(first);
    trim(text);
    if (text[0] && strcmp(text, first) != 0)
        snprintf(why, size, "%.200s (and its shapes are not used: %.150s)", text, first);
    else
        snprintf(why, size, "%s", first[0] ? first : "MuJoCo cannot read it");
    return NULL;
}

#endif
