// Copyright 2026 The impact_rig developers
//
// Licensed under the Apache License, Version 2.0 (the "License");
// you may not use this file except in compliance with the License.
// You may obtain a copy of the License at
//
//     http://www.apache.org/licenses/LICENSE-2.0
//
// Unless required by applicable law or agreed to in writing, software
// distributed under the License is distributed on an "AS IS" BASIS,
// WITHOUT WARRANTIES OR CONDITIONS OF ANY KIND, either express or implied.
// See the License for the specific language governing permissions and
// limitations under the License.

/* Calls compiled kernels from Python: unpacks arguments into slots of eight bytes, lets go of the interpreter, calls.
 *
 * The kernels are compiled elsewhere (build.py) into functions `int32_t name(uint64_t *in, uint64_t *out)`. `in` holds
 * the arguments one after another as a plan says, a letter a piece:
 *
 *     f  a float           i  an int        b  a bool        one slot each
 *     p  a Pointer         its address and two zeros, as Numba hands over functions
 *     1, 2, 3  an array in C order of so many dimensions: 0, 0, elements, bytes of one, address, shape, strides
 *     (n …     a tuple of n pieces
 *
 * Types are checked at every call: a wrong one raises TypeError and nothing is called. Only the stable part of Python's
 * interface is used (from 3.11 on), so one file serves every Python.
 */
#define Py_LIMITED_API 0x030B0000
#define PY_SSIZE_T_CLEAN
#include <Python.h>
#include <stdint.h>
#include <stdlib.h>
#include <string.h>

typedef int32_t (*kernel)(uint64_t *in, uint64_t *out);

/* made by build.py */
extern const char kernel_sources[];
void *impact_rig_address(const char *name); /* of kernels.c */

enum { MOST_SLOTS = 320, MOST_ARRAYS = 48, MOST_RESULTS = 4 };

typedef struct {
    const char *name;
    kernel call;
    char plan[256];
    char results[MOST_RESULTS + 1];
    Py_ssize_t arrays;
    PyObject *dtype[MOST_ARRAYS]; /* as declared */
    PyObject *known[MOST_ARRAYS]; /* the equal one that came last */
} entry;

typedef struct {
    const entry *of;
    uint64_t in[MOST_SLOTS];
    Py_ssize_t filled;
    Py_buffer view[MOST_ARRAYS];
    Py_ssize_t views;
    const char *plan;
} call;

static PyObject *of_dtype; /* "dtype" */
static PyObject *of_address;

static int put(call *c, uint64_t value)
{
    c->in[c->filled++] = value;
    return 1;
}

static int array(call *c, PyObject *value, int dimensions)
{
    entry *e = (entry *)c->of;
    Py_ssize_t which = c->views;
    PyObject *dtype = PyObject_GenericGetAttr(value, of_dtype);
    if (!dtype) return 0;
    if (dtype != e->known[which]) {
        int same = PyObject_RichCompareBool(dtype, e->dtype[which], Py_EQ);
        if (same < 0) {
            Py_DECREF(dtype);
            return 0;
        }
        if (!same) {
            PyErr_Format(PyExc_TypeError, "%s: array %zd must hold %R, got %R", e->name, which, e->dtype[which], dtype);
            Py_DECREF(dtype);
            return 0;
        }
        PyObject *before = e->known[which];
        e->known[which] = Py_NewRef(dtype);
        Py_XDECREF(before);
    }
    Py_DECREF(dtype);
    Py_buffer *view = &c->view[which];
    if (PyObject_GetBuffer(value, view, PyBUF_C_CONTIGUOUS)) return 0;
    c->views++;
    if (view->ndim != dimensions) {
        PyErr_Format(PyExc_TypeError, "%s: array %zd must have %d dimensions, got %d", e->name, which, dimensions, view->ndim);
        return 0;
    }
    put(c, 0), put(c, 0), put(c, (uint64_t)(view->itemsize ? view->len / view->itemsize : 0));
    put(c, (uint64_t)view->itemsize), put(c, (uint64_t)(uintptr_t)view->buf);
    for (int i = 0; i < dimensions; i++) put(c, (uint64_t)view->shape[i]);
    for (int i = 0; i < dimensions; i++) put(c, (uint64_t)view->strides[i]);
    return 1;
}

static int piece(call *c, PyObject *value)
{
    char letter = *c->plan++;
    switch (letter) {
    case 'f': {
        double number = PyFloat_AsDouble(value);
        uint64_t bits;
        if (number == -1.0 && PyErr_Occurred()) return 0;
        memcpy(&bits, &number, sizeof bits);
        return put(c, bits);
    }
    case 'i':
    case 'b': {
        PyObject *index = PyNumber_Index(value);
        if (!index) { /* NumPy's bool is no index */
            int truth;
            if (letter == 'i') return 0;
            PyErr_Clear();
            truth = PyObject_IsTrue(value);
            return truth < 0 ? 0 : put(c, (uint64_t)truth);
        }
        int64_t number = PyLong_AsLongLong(index);
        Py_DECREF(index);
        if (number == -1 && PyErr_Occurred()) return 0;
        return put(c, (uint64_t)(letter == 'b' ? number != 0 : number));
    }
    case 'p': {
        PyObject *address = PyObject_GetAttr(value, of_address);
        if (!address) return 0;
        void *where = PyLong_AsVoidPtr(address);
        Py_DECREF(address);
        if (!where && PyErr_Occurred()) return 0;
        return put(c, (uint64_t)(uintptr_t)where) && put(c, 0) && put(c, 0);
    }
    case '(': {
        Py_ssize_t count = *c->plan++;
        if (!PyTuple_Check(value) || PyTuple_Size(value) != count) {
            PyErr_Format(PyExc_TypeError, "%s: expected a tuple of %zd, got %R", c->of->name, count, value);
            return 0;
        }
        for (Py_ssize_t i = 0; i < count; i++)
            if (!piece(c, PyTuple_GetItem(value, i))) return 0;
        return 1;
    }
    default:
        return array(c, value, letter - '0');
    }
}

static PyObject *result(char letter, uint64_t value)
{
    return letter == 'b' ? PyBool_FromLong(value != 0) : PyLong_FromLongLong((int64_t)value);
}

static PyObject *called(PyObject *capsule, PyObject *const *arguments, Py_ssize_t count)
{
    call c;
    c.of = PyCapsule_GetPointer(capsule, NULL);
    c.filled = c.views = 0;
    c.plan = c.of->plan;
    PyObject *found = NULL;
    Py_ssize_t i = 0;
    while (i < count && *c.plan)
        if (!piece(&c, arguments[i++])) goto done;
    if (i < count || *c.plan) {
        PyErr_Format(PyExc_TypeError, "%s: wrong number of arguments, got %zd", c.of->name, count);
        goto done;
    }
    uint64_t out[MOST_RESULTS];
    int32_t status;
    Py_BEGIN_ALLOW_THREADS
    status = c.of->call(c.in, out);
    Py_END_ALLOW_THREADS
    if (status) {
        PyErr_Format(PyExc_RuntimeError, "%s: stopped with status %d", c.of->name, (int)status);
        goto done;
    }
    Py_ssize_t results = (Py_ssize_t)strlen(c.of->results);
    if (results == 0) {
        found = Py_NewRef(Py_None);
    } else if (results == 1) {
        found = result(c.of->results[0], out[0]);
    } else {
        found = PyTuple_New(results);
        for (Py_ssize_t k = 0; found && k < results; k++) PyTuple_SetItem(found, k, result(c.of->results[k], out[k]));
    }
done:
    for (Py_ssize_t k = 0; k < c.views; k++) PyBuffer_Release(&c.view[k]);
    return found;
}

static PyMethodDef method = {"entry", (PyCFunction)(void (*)(void))called, METH_FASTCALL, "A compiled kernel."};

/* How many slots a plan fills. */
static Py_ssize_t slots(const char *plan)
{
    Py_ssize_t count = 0;
    for (; *plan; plan++) {
        if (*plan == '(') plan++;
        else count += *plan == 'p' ? 3 : *plan >= '1' && *plan <= '3' ? 5 + 2 * (*plan - '0') : 1;
    }
    return count;
}

static PyObject *library_entry(PyObject *Py_UNUSED(module), PyObject *arguments)
{
    const char *name, *plan, *results;
    PyObject *dtypes;
    if (!PyArg_ParseTuple(arguments, "ssO!s", &name, &plan, &PyTuple_Type, &dtypes, &results)) return NULL;
    void *address = impact_rig_address(name);
    if (!address) return PyErr_Format(PyExc_LookupError, "the library holds no kernel %s: build it again", name);
    Py_ssize_t arrays = PyTuple_Size(dtypes);
    if (strlen(plan) >= 256 || strlen(results) > MOST_RESULTS || arrays > MOST_ARRAYS || slots(plan) > MOST_SLOTS)
        return PyErr_Format(PyExc_ValueError, "%s: more arguments than library.c has room for", name);
    entry *e = calloc(1, sizeof *e); /* for the life of the process */
    if (!e) return PyErr_NoMemory();
    e->name = strdup(name);
    e->call = (kernel)address;
    e->arrays = arrays;
    strcpy(e->plan, plan);
    strcpy(e->results, results);
    for (Py_ssize_t i = 0; i < arrays; i++) {
        e->dtype[i] = Py_NewRef(PyTuple_GetItem(dtypes, i));
        e->known[i] = Py_NewRef(e->dtype[i]);
    }
    PyObject *capsule = PyCapsule_New(e, NULL, NULL);
    if (!capsule) return NULL;
    PyObject *found = PyCFunction_NewEx(&method, capsule, NULL);
    Py_DECREF(capsule);
    return found;
}

static PyObject *library_address(PyObject *Py_UNUSED(module), PyObject *name)
{
    PyObject *bytes = PyUnicode_AsUTF8String(name);
    if (!bytes) return NULL;
    void *address = impact_rig_address(PyBytes_AsString(bytes));
    Py_DECREF(bytes);
    return PyLong_FromVoidPtr(address);
}

static PyObject *library_sources(PyObject *Py_UNUSED(module), PyObject *Py_UNUSED(nothing))
{
    return PyUnicode_FromString(kernel_sources);
}

static PyMethodDef methods[] = {
    {"entry", library_entry, METH_VARARGS, "entry(name, plan, dtypes, results): return a kernel that Python can call."},
    {"address", library_address, METH_O, "Return the address of an exported function, 0 where there is none."},
    {"sources", library_sources, METH_NOARGS, "Return the files it was built from and their digests, as JSON."},
    {NULL, NULL, 0, NULL},
};

static struct PyModuleDef definition = {
    .m_base = PyModuleDef_HEAD_INIT, .m_name = "_library", .m_doc = "The compiled kernels.", .m_size = -1,
    .m_methods = methods,
};

PyMODINIT_FUNC PyInit__library(void)
{
    of_dtype = PyUnicode_InternFromString("dtype");
    of_address = PyUnicode_InternFromString("address");
    return of_dtype && of_address ? PyModule_Create(&definition) : NULL;
}
